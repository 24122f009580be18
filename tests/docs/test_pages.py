"""Pages are complete: reasons, navigation, the tests and the reports that they name."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from samples.source import PROJECT

REPORTS = sorted(path for path in (PROJECT / "reports").iterdir() if path.is_dir())
PAGES = [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md", *PROJECT.glob("docs/**/*.md")]


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    text = (PROJECT / "mkdocs.yml").read_text("utf-8")
    listed = set(re.findall(r": ([\w./-]+\.md)$", text, re.MULTILINE))
    docs = PROJECT / "docs"
    pages = {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")}
    assert {page for page in pages if not page.startswith("decisions/0")} <= listed


def test_the_tests_behind_each_guarantee_exist() -> None:
    page = (PROJECT / "docs" / "reference" / "guarantees.md").read_text("utf-8")
    for path, _, name in re.findall(r"`((?:\w+/)*tests/[\w/.]+)(::(\w+))?`", page):
        assert (PROJECT / path).exists(), path
        assert not name or f"def {name}(" in (PROJECT / path).read_text("utf-8"), name


@pytest.mark.parametrize("folder", REPORTS, ids=lambda path: path.name)
def test_a_report_is_complete_and_names_its_command(folder: Path) -> None:
    text = (folder / "REPORT.md").read_text("utf-8")
    assert re.search(
        r"^    (python -m |segloc |experiments/|tests/ros2/run.sh )", text, re.MULTILINE
    )
    assert json.loads((folder / "rows.json").read_text("utf-8"))
    assert "commit" in (folder / "environment.txt").read_text("utf-8")


def test_pages_link_only_to_the_newest_report_of_a_topic() -> None:
    newest: dict[str, tuple[int, ...]] = {}
    for folder in REPORTS:
        version, _, topic = folder.name.partition("-")
        newest[topic] = max(newest.get(topic, ()), _numbers(version))
    for page in PAGES:
        found = re.findall(r"reports/([\d.]+)-([\w-]+)/", page.read_text("utf-8"))
        for version, topic in found:
            assert newest.get(topic) == _numbers(version), f"{page.name}: {version}-{topic}"


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))
