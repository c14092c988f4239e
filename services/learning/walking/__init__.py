"""What tracks teach of walking: how long steps are, how phones are turned, whose clock is off."""
