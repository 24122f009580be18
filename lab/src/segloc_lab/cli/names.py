"""Lists of names on the command line."""

from __future__ import annotations

from segloc.errors import ConfigError


def split_names(given: str | None, option: str = "--methods") -> tuple[str, ...] | None:
    """Split a list of names separated by commas."""
    if given is None:
        return None
    names = tuple(name.strip() for name in given.split(","))
    if not all(names):
        raise ConfigError(f"{option} {given!r}: empty name")
    return names
