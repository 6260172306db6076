"""Chapter 4: a depth map, or a picture with its depth map, coded by wavelets that stop at shared edges."""
