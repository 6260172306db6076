"""Structure from motion between two key frames: arrays in, model out."""
