"""Maps of whole sequences: cameras of all frames, depth of some, and one cloud of points."""
