"""What people look at: pictures, pages, meshes."""
