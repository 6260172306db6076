"""The thesis measured again: each printed number next to those of its method as written and of ours."""
