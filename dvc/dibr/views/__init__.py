"""Views that one reference predicts by its disparities (chapter 3): views in, a stream out, and back."""
