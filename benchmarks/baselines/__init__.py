"""What else codes several views of a scene, to compare with."""
