"""Fusion: anonymous positions from all cameras of an area, names from radio and motion, joined into tracks."""
