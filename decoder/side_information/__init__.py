"""Prediction of Wyner-Ziv frames at the decoder: methods, found by name in `methods`."""
