"""Things that stand in a world, as triangles."""
