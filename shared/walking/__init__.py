"""Stride and motion models: what walking people do, for everybody who follows them."""
