"""segloc in place of the alignment service of Autoware's NDT scan matcher."""
