"""Files that were made to break the readers, and their errors."""
