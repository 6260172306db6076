"""The pictures of `docs`."""
