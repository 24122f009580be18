"""LiDARs: which rays they cast, and what returns."""
