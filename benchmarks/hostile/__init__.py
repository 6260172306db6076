"""Hostile input: mutations of streams and live messages, and what they do."""
