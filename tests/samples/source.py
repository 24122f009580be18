"""What the source says of itself: who imports whom, and how long things are."""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parents[2]
ROOT = "__init__"  # the package itself, among names that leave it out


class Length(NamedTuple):
    """Lines of something, and where it begins."""

    lines: int
    where: str


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
        reached = {name: self.reached({name}, whole_packages=False) for name in self.files}
        groups = {
            tuple(sorted(b for b in self.files if b in reached[a] and a in reached[b]))
            for a in self.files
        }
        return [list(group) for group in sorted(groups) if len(group) > 1]

    def reached(self, starts: set[str], whole_packages: bool = True) -> set[str]:
        """Modules that are loaded when some are: with the packages they are in, or without."""
        seen: set[str] = set()
        pending = list(starts)
        while pending:
            name = pending.pop()
            if name in seen or name not in self.files:
                continue
            seen.add(name)
            pending += self.imports[name]
            if whole_packages and "." in name:
                pending.append(name.rpartition(".")[0])
        return seen

    def used_by(self, paths: Iterator[Path]) -> set[str]:
        """Modules that files outside the package name."""
        found = {item for path in paths for item in imported(path, ())}
        return {own for item in found if (own := self._own(item)) is not None}


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


def python_functions(path: Path) -> Iterator[Length]:
    """Functions, their signatures counted and their docstrings not."""
    for node in ast.walk(_parsed(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = _span(node) - (_span(node.body[0]) if ast.get_docstring(node) else 0)
            yield Length(lines, f"{_place(path, node.lineno)} {node.name}")


def _span(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def cpp_functions(path: Path) -> Iterator[Length]:
    """Bodies as clang-format lays them out: to the brace that stands where the first line began."""
    no_function = ("namespace", "struct", "class", "enum", "union", "extern", "//", "#", "}")
    begin, closing = None, ""
    for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
        text = line.lstrip()
        indent = line[: len(line) - len(text)]
        if begin is None:
            if text.endswith("{") and len(indent) <= 2 and not text.startswith(no_function):
                begin, closing = number, indent + "}"
        elif line.startswith(closing):
            yield Length(number - begin + 1, _place(path, begin))
            begin = None


def files(*folders: str, suffixes: tuple[str, ...] = (".py",)) -> Iterator[Path]:
    """Files of some folders of the project."""
    for folder in folders:
        yield from (p for p in sorted((PROJECT / folder).rglob("*")) if p.suffix in suffixes)


def lengths(paths: Iterator[Path], of: Callable[[Path], Iterator[Length]]) -> list[Length]:
    """The longest first."""
    return sorted((item for path in paths for item in of(path)), reverse=True)


def file_length(path: Path) -> Iterator[Length]:
    yield Length(path.read_bytes().count(b"\n"), str(path.relative_to(PROJECT)))


def _place(path: Path, line: int) -> str:
    return f"{path.relative_to(PROJECT)}:{line}"
