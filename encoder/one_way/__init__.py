"""What to send of Wyner-Ziv frames where no decoder asks, by the encoder's own frames and tracks."""
