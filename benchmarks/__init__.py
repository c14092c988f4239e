"""Experiments: each module measures one thing, prints its table and writes its result as JSON."""
