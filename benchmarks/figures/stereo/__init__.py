"""Stereo from camera arrays: surfaces against the truth and against OpenCV, layers, consistency, times."""
