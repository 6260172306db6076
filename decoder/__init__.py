"""Receiver side: side information, parity requests, reconstruction."""
