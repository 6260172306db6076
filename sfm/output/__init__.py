"""What is made of a model: files for other programs, and pictures."""
