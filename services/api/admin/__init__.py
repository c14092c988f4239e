"""What the API keeps itself: zones and exhibits, keys and people, and who asked for or changed what."""
