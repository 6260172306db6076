"""A page in which one flies along the path of the camera, or looks at the scene from anywhere."""
