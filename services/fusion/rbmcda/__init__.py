"""The original identity filter: particles of association histories over a bank of unscented filters."""
