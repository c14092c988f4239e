"""What would a phone hear? Power of every access point at every place and time, and when phones listen."""
