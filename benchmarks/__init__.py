"""What is measured and drawn with the codec, and a demonstration of it."""
