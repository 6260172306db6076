"""Answers to what a live decoder asks of the frames that it works at."""
