"""Chapter 4: wavelets that stop at shared edges, on maps, pictures and signals."""
