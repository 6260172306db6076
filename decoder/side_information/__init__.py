"""Prediction of Wyner-Ziv frames at the decoder."""
