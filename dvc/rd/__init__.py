"""Rate-distortion experiments: sweeps, results, reports."""
