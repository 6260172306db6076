"""Other coders of two views to compare with."""
