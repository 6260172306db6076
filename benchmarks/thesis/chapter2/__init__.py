"""Chapter 2: stereo from planar camera arrays."""
