"""Rate control where no decoder asks: what to send of Wyner-Ziv frames, by frames and tracks."""
