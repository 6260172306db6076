"""Prediction by block motion: in two dimensions, without a model of the scene."""
