"""Who is who? Evidence of radio and motion for every pair of device and anonymous track."""
