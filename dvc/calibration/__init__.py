"""Calibrated cameras: from files of several kinds, or estimated from plain pictures."""
