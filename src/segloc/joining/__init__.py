"""Join sessions and maps: check that they share a frame, and update a map."""
