"""Old names of moved packages: imports work for one version, with a warning of the new name."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Mapping
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


class _Moved:
    """A finder and loader of ``sys.meta_path``."""

    def __init__(self, packages: Mapping[str, str]) -> None:
        self._packages = packages

    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        for old, new in self._packages.items():
            if name == old or name.startswith(f"{old}."):
                loader: Any = self
                return ModuleSpec(name, loader, origin=new + name[len(old) :])
        return None

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave it to Python: the module is replaced."""

    def exec_module(self, module: ModuleType) -> None:
        spec: Any = module.__spec__
        sys.modules[spec.name] = importlib.import_module(spec.origin)
        message = f"{spec.name} is {spec.origin}; the old name works in this version only"
        warnings.warn(message, DeprecationWarning, stacklevel=2)


def alias(packages: Mapping[str, str]) -> None:
    """Let modules of packages be imported by their old names.

    Parameters
    ----------
    packages : dict of str to str
        New full names by old ones.
    """
    # First: others would find the modules of a moved package on its path, and load them again.
    sys.meta_path.insert(0, _Moved(packages))
