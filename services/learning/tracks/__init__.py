"""What a device and a track did together: the stretches all lessons are drawn from, and how good each is."""
