"""Modules of the project: files outside of packages, and imports read from the source."""

from __future__ import annotations

import ast
import functools
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

PROJECT = Path(__file__).resolve().parents[2]
ROOT = "__init__"  # the package itself, among names that leave it out


def loaded(path: Path) -> ModuleType:
    """Import a file that is in no package."""
    name = f"loaded_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # its dataclasses look their module up
    spec.loader.exec_module(module)
    return module


class Package:
    """The modules of a package by name, the package's own left out: ``map.build``.

    Parameters
    ----------
    folder : path
        The package's.
    native : set of str
        Modules that are not written in Python.
    """

    def __init__(self, folder: Path, native: frozenset[str] = frozenset()) -> None:
        self.name = folder.name
        self.files = {_dotted(path.relative_to(folder)): path for path in folder.rglob("*.py")}
        self.known = {*self.files, *native}
        self.imports = {name: self._imported(name) for name in self.files}

    def _imported(self, name: str) -> set[str]:
        """Modules of the package, and other packages as ``!numpy``."""
        path = self.files[name]
        here = () if name == ROOT else tuple(name.split("."))
        if path.name != "__init__.py":
            here = here[:-1]
        found = imported(path, (self.name, *here))
        return {self._own(item) or f"!{item.split('.')[0]}" for item in found} - {name}

    def _own(self, item: str) -> str | None:
        """The module of the package that an imported name is, or is in."""
        if item.split(".")[0] != self.name:
            return None
        inner = item[len(self.name) + 1 :]
        while inner and inner not in self.known:
            inner = inner.rpartition(".")[0]
        return inner or ROOT

    def circles(self) -> list[list[str]]:
        """Modules that reach each other, in groups."""
        reached = {name: self.reached(name) for name in self.files}
        groups = {
            tuple(sorted(b for b in self.files if b in reached[a] and a in reached[b]))
            for a in self.files
        }
        return [list(group) for group in sorted(groups) if len(group) > 1]

    def reached(self, start: str) -> set[str]:
        """Modules that are loaded with one, the packages they are in left out."""
        seen: set[str] = set()
        pending = [start]
        while pending:
            name = pending.pop()
            if name not in seen and name in self.files:
                seen.add(name)
                pending += self.imports[name]
        return seen


def _dotted(path: Path) -> str:
    parts = path.with_suffix("").parts
    if parts[-1] == "__init__":
        parts = parts[:-1]
    return ".".join(parts) or ROOT


@functools.cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def imported(path: Path, package: tuple[str, ...]) -> set[str]:
    """Full names of all that a file imports, at its top, in functions, and for types alone."""
    found: set[str] = set()
    for node in ast.walk(_parsed(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{stem}.{alias.name}" for alias in node.names}
    return found
