"""Where is everybody? Anonymous tracks from all cameras of an area."""
