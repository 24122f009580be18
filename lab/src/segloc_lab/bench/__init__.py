"""Measurements of the native engine against other software for the same work: ``segloc bench``."""
