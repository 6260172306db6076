"""Estimation of the points that two key frames have in common [Maitre2008, Sec. 5.2.4]."""
