"""Robust estimation of the epipolar geometry, and whether there is any [Maitre2008, Sec. 5.2.3]."""
