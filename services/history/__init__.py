"""What happened: tracks, alerts and occupancy in a database, and what is asked of them."""
