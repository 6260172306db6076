"""Pictures with depth: views and their disparities in one stream, depth images, layers."""
