"""Pictures of a reference view as embedded streams."""
