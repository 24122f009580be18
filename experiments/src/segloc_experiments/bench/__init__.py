"""Measurements of the native engine against what else does the same work."""
