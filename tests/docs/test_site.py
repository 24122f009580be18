"""The pages of the site that are read off the code."""

from __future__ import annotations

import ast
import re
from types import ModuleType
from typing import Any

import pytest
import typer
from samples.source import PROJECT, loaded

from segloc.live.core import StateReason
from segloc.localization import Reason
from segloc.tools.cli import app


@pytest.fixture(scope="module")
def site() -> ModuleType:
    return loaded(PROJECT / "docs" / "site.py")


@pytest.mark.parametrize(
    ("role", "shown"),
    [
        (":class:`~segloc.Localizer`", "[`Localizer`][segloc.Localizer]"),
        (":meth:`Localizer.localize`", "[`Localizer.localize`][segloc.Localizer.localize]"),
        (":func:`segloc.open_sequence`", "[`open_sequence`][segloc.open_sequence]"),
        (":func:`~segloc.tools.datasets.parse_select`", "`parse_select`"),
        (":data:`STAGES`", "`STAGES`"),
        (":mod:`.lattice`", "`lattice`"),
    ],
)
def test_roles_of_docstrings_become_links_or_code(site: ModuleType, role: str, shown: str) -> None:
    assert site.resolved(f"As {role} does.") == f"As {shown} does."


def test_no_role_is_left_in_the_package(site: ModuleType) -> None:
    for path in (PROJECT / "src" / "segloc").rglob("*.py"):
        assert not re.search(r":[a-z]+:`", site.resolved(path.read_text("utf-8"))), path


def test_every_verb_and_key_has_its_place(site: ModuleType) -> None:
    root: Any = typer.main.get_command(app)
    pages = "".join(site.commands(root, "segloc"))
    for name in ("segloc map build", "segloc localize", "segloc train extract", "segloc view"):
        assert f"\n## {name}\n" in pages
    assert "| its own |" in pages
    assert "min_confidence: 0.99  # least probability of" in site.configuration()


def test_every_reason_has_a_row_with_cause_and_remedy(site: ModuleType) -> None:
    page = site.filled((PROJECT / "docs/reference/messages.md").read_text("utf-8"))
    for reason in (*Reason, *StateReason):
        assert reason.likely_cause and reason.remedy, reason
        assert f"| {reason.likely_cause} | {reason.remedy} |" in page


def test_every_reason_of_the_tracker_has_a_remedy() -> None:
    tree = ast.parse((PROJECT / "src" / "segloc" / "tracking" / "belief.py").read_text("utf-8"))
    known = [re.sub(r"\{.*?\}.*", "", reason.value) for reason in StateReason]
    for method in ast.walk(tree):
        if isinstance(method, ast.FunctionDef) and method.name in ("status", "_loss_reason"):
            texts = [node.value for node in ast.walk(method) if isinstance(node, ast.Constant)]
            for text in texts[1 if ast.get_docstring(method) else 0 :]:
                if isinstance(text, str) and len(text.split()) > 2:
                    assert any(text.startswith(start) for start in known), text
