"""What would a camera show? Rendered pictures for the real camera service."""
