"""What to send of Wyner-Ziv frames where no decoder asks: estimates from the encoder's own frames and tracks."""
