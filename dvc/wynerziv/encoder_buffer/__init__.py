"""Answers to what a decoder asks of the frames that it works at."""
