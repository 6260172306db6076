"""Chapter 3: joint estimation and coding of pictures and disparities."""
