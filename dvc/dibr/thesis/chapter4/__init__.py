"""Chapter 4 measured again: wavelets that stop at shared edges, on maps, pictures and signals."""
