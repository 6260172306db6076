"""Disparity maps that predict views best for their bits: integer wavelets, and what to compare them with."""
