"""Pictures with depth as streams, from which any view can be rendered (chapters 3 and 4)."""
