"""``segloc config``"""

from __future__ import annotations


def config() -> None:
    """Print the whole configuration as YAML, every default written out."""
    from ..config import Config

    print(Config().to_yaml(), end="")
