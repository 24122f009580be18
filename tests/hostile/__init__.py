"""Files that were made to break the readers, and what must be said of them."""
