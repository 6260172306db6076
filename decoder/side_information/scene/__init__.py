"""Prediction from a model of the scene: one file a way to model the motion between two key frames."""
