"""What good tracks teach of an area's radio: constants, map, phones' offsets, what changed and where things hang."""
