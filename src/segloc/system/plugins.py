"""What other packages add to segloc, by entry points."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from typing import Any

from ..errors import ConfigError


@cache
def plugins(group: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Load the entry points of a group.

    Returns
    -------
    dict
        Objects by name.
    dict
        Faults by name, of those that cannot be loaded: a broken package must not break segloc.
    """
    loaded: dict[str, Any] = {}
    faults: dict[str, str] = {}
    for entry in entry_points(group=group):
        try:
            loaded[entry.name] = entry.load()
        except Exception as error:
            faults[entry.name] = f"{entry.value}: {error}"
    return loaded, faults


def require_attributes(what: str, made: Any, names: tuple[str, ...]) -> None:
    """Reject an object of a plug-in that lacks attributes.

    Raises
    ------
    ConfigError
    """
    if missing := [name for name in names if not hasattr(made, name)]:
        raise ConfigError(f"{what}: {type(made).__name__} has no {', '.join(missing)}")
