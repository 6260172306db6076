"""Coding of point tracks by the motion of all tracks of an instant that are coded so far."""
