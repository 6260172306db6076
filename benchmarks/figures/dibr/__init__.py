"""Views and depth, coded together: the codec of the reference view, and what is built on it."""
