"""``segloc demo``"""

from __future__ import annotations


def demo() -> None:
    """Map a simulated town, then localize a second traversal of it and another town."""
