"""Did this person walk as that phone says? Paths of tracks, and stretches of phones' walks held against them."""
