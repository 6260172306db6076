"""The stream of texture + depth: a header, and quality layers that can be cut off."""
