"""Towns, parks, meadows, forests and industrial sites, drawn from a seed."""
