"""A viewer: decoded scenes as one HTML page in which the viewpoint is moved by hand."""
