"""The laboratory stands on public names of segloc, and no two of its modules on each other."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import segloc_lab
from samples.source import Package

DEEPER = ("segloc.system", "segloc.tools.cli", "segloc.tools.datasets", "segloc.descriptors")
"""Rooms whose modules are names themselves: helpers and plug-ins."""


def imported() -> Iterator[tuple[str, str]]:
    """Every (module of segloc, name) that the laboratory imports."""
    for path in Path(segloc_lab.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                yield from ((a.name, "") for a in node.names if a.name.split(".")[0] == "segloc")
            elif isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith("segloc."):
                yield from ((str(node.module), a.name) for a in node.names if not node.level)


def test_the_laboratory_imports_public_names_at_most_one_level_deep() -> None:
    found = set(imported())
    parts = {part for module, name in found for part in (*module.split("."), name)}
    assert ("segloc", "Localizer") in found
    assert {p for p in parts if p.startswith("_") and p != "__version__"} == set()
    deep = {
        m
        for m, _ in found
        if m.replace(".tools.", ".", 1).count(".") > 1 and not m.startswith(DEEPER)
    }
    assert deep == set()


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert list(Package(Path(segloc_lab.__file__).parent).circles()) == []
