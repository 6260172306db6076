"""Chapter 2: surfaces of all cameras of a planar array, layered depth images, and sprites with depth."""
