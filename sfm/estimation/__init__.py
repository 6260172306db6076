"""Robust estimation of the epipolar geometry, and tests for its existence [Maitre2008, Sec. 5.2.3]."""
