"""Rate control: what Wyner-Ziv frames need, by frames and tracks, and qualities that keep a bitrate."""
