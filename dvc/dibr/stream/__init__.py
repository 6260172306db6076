"""The stream of pictures with depth: a header, and quality layers that can be cut off."""
