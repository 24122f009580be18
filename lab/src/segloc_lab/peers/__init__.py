"""Other systems on the same clouds; each module runs as a script."""
