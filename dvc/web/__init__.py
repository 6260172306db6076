"""Self-contained HTML pages: document, galleries, plots, and the stage of pages about scenes."""
