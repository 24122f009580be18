"""Late imports for methods that use packages above their own."""

from __future__ import annotations

import importlib
from typing import Any

_PACKAGE = __package__.rpartition(".")[0]


def from_above(module: str, name: str) -> Any:
    """Return an attribute of a module of this package, imported when a method is first called.

    For conveniences only, such as ``SegmentMap.from_scans``; no stage of a query uses it.
    """
    return getattr(importlib.import_module(f"{_PACKAGE}.{module}"), name)
