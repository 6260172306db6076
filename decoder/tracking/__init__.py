"""Tracking at the decoder: received points become tracks between two key frames, tracks give cameras."""
