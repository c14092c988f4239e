"""Learning: the tracks teach the sensors, and only what wins goes live."""
