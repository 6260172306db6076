"""Chapter 4: depth maps and pictures by wavelets that stop at shared edges."""
