"""How the shipped weights are made, and what is measured of them."""
