"""What a past full of positions tells: pure functions of arrays."""
