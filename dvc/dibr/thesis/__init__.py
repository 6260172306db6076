"""Figures and tables of chapter 3, measured again, on any views."""
