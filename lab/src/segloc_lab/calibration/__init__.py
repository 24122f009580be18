"""How the confidence of a pose is fitted."""
