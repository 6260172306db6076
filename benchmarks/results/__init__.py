"""Headline results: definition, measurement, code digests and documents."""
