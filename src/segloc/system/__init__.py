"""Files, locks, processes, clocks and settings; lazy imports of packages."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping


def lazy(
    package: str, names: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package that imports names on first use.

    Parameters
    ----------
    package : str
    names : dict of str to str
        Names, separated by spaces, by the submodule that defines them. The package imports the
        same names under ``if TYPE_CHECKING:``.
    """
    homes = {name: f"{package}.{module}" for module in names for name in names[module].split()}

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(homes[name]), name)

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return get, listed
