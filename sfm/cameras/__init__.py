"""Cameras and depths: of two key frames, and of the frames between them [Maitre2008, Secs. 5.2.3, 5.3.1]."""
