"""What coding costs the camera."""
