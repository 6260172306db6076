"""Views and their depth, coded together: streams from which any view can be rendered (chapters 3 and 4)."""
