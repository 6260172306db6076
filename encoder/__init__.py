"""Camera side: key frames, parity of the Wyner-Ziv frames, answers to parity requests."""
