"""Chapter 5: side information from the geometry of the scene."""
