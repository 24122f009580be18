"""Files, locks, processes, clocks and settings; lazy imports of packages."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping


def lazy(
    module: str, names: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a module that imports names on first use.

    Parameters
    ----------
    module : str
    names : dict of str to str
        Names, separated by spaces, by the module of the same package that defines them. The module
        imports the same names under ``if TYPE_CHECKING:``.
    """
    package = sys.modules[module].__package__
    homes = {name: f"{package}.{home}" for home in names for name in names[home].split()}

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return getattr(importlib.import_module(homes[name]), name)

    def list_names() -> list[str]:
        return sorted({*vars(sys.modules[module]), *homes})

    return get, list_names
