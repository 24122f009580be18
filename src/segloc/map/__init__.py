"""The prior map: segments, cloud, file, building, merging and updating."""
