"""What every service speaks: messages, keys, bus, settings, the life of a process, the site."""
