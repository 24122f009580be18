"""The studies of the paper: ``segloc evaluate``."""
