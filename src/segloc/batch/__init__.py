"""Many queries at once: run them, score them, and show where and why they fail."""
