"""Stored answers of a fixed corpus, which a change of the source's structure must not alter."""
