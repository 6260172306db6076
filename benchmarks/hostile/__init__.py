"""Hostile input: mutations of streams and live messages, and their outcomes."""
