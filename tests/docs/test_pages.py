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


def test_figures_of_the_readme_are_in_the_reports_that_it_names() -> None:
    """As they are, in one row of a table, or as the sum of a row."""
    found = 0
    for line in (PROJECT / "README.md").read_text("utf-8").splitlines():
        named = re.findall(r"\((reports/[^)#]+\.md)", line)
        rows = [row for path in named for row in _plain((PROJECT / path).read_text("utf-8"))]
        for figure in _shares(_plain(line)[0]) if named else ():
            found += 1
            assert any(_holds(row, *figure) for row in rows), f"{figure} in {named}"
    assert found > 5


def _plain(text: str) -> list[str]:
    """Lines without thousands' spaces and links."""
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return re.sub(r"(?<=\d) (?=\d{3}\b)", "", text).splitlines()


def _shares(line: str) -> list[tuple[int, int]]:
    return [(int(n), int(m)) for n, m in re.findall(r"\b(\d+) of (\d+)\b", line)]


def _holds(row: str, hits: int, of: int) -> bool:
    shares = _shares(row)
    total = tuple(map(sum, zip(*shares, strict=True)))
    numbers = set(re.findall(r"\d+", re.sub(r"\bnone\b", "0", row)))
    return {str(hits), str(of)} <= numbers or total == (hits, of)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))
