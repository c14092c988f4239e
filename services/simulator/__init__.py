"""A twin of the site: walkers, the camera's rendered picture, phones with radio and inertial sensors, and the truth.

The services cannot tell it from a real site: pictures arrive as an MJPEG stream, phones post through the HTTP gateway.
"""
