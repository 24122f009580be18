"""The report: one page that is whole, stands alone and is the same each time."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.evaluation.report import drawing
from segloc_lab.evaluation.report import html as report
from segloc_lab.evaluation.report.study import Figure, Kind, Study, Table

VOID = {"meta", "br", "link", "img", "hr", "input"}


class Page(HTMLParser):
    """Collects what a page refers to, and checks that every tag is closed where it should be."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.words = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "action", "data"):
                self.references.append(value or "")
            if name == "id":
                self.ids.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.open = self.open[:-1] if tag not in VOID else self.open

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> is out of place"

    def handle_data(self, data: str) -> None:
        self.words += data


def figure(kind: Kind, name: str) -> Figure:
    x = np.linspace(0, 1, 50)
    series = {"<dsm> & co": (x, x**0.5), "geo": (x, x**0.7)}
    if kind == "map":
        path = (np.array([0.0, 40.0, np.nan, 60.0]), np.array([0.0, 5.0, np.nan, 9.0]))
        series |= {"map": (60 * x, 60 * x**2), "path of the map": path, "localized": (x, x)}
        series |= {"localized falsely": (x[:0], x[:0]), "not localized": (x, 1 - x)}
    return Figure(name, "A <figure>", kind, series, "x", "y", "A note & more.")


def studies() -> list[Study]:
    kinds: tuple[Kind, ...] = ("roc", "polar", "bars", "map", "lines")
    figures = tuple(figure(kind, f"{kind}-{k}") for k in (0, 1) for kind in kinds)
    ours = Table("ours", "Ours <b>", ("m", "n"), (("dsm & fq", 1.5), ("x<y", None)), "Note <i>.")
    theirs = Table("theirs", "Theirs", ("m", "n"), (("dsm", 2),), source="paper")
    long = Table("long", "Long", ("k",), tuple((k,) for k in range(60)))
    facts = {"command": "segloc evaluate 'a&b' <c>", "seed": 0, "fingerprints": {"geo": "geo-1"}}
    return [
        Study("one", "One & only", (ours, theirs, long), figures, facts, "First.\n\nSecond <p>."),
        Study("two", "Two"),
    ]


@pytest.fixture(scope="module")
def text() -> str:
    return report.page(studies())


@pytest.mark.slow
def test_the_page_is_well_formed_and_stands_alone(text: str) -> None:
    page = Page(text)
    assert page.open == []
    for reference in page.references:
        assert reference.startswith(("#", "data:image/png;base64,")), reference[:80]
    assert not re.search(r"@import|url\((?!#)", text)
    assert len(set(page.ids)) == len(page.ids)
    local = {reference[1:] for reference in page.references if reference.startswith("#")}
    assert local <= set(page.ids)
    clips = set(re.findall(r"url\(#([^)]+)\)", text))
    assert clips <= set(page.ids)


@pytest.mark.slow
def test_the_page_says_everything(text: str) -> None:
    words = Page(text).words
    for part in ("One & only", "Second <p>.", "Note <i>.", "x<y", "segloc evaluate 'a&b' <c>"):
        assert part in words
    assert words.count("published") == 2  # the introduction, and the one table that is
    assert "geo-1" in words and "A note & more." in words and "<dsm> & co" in words


@pytest.mark.slow
def test_figures_of_one_fold_lie_behind_its_title() -> None:
    folds = {"a": "", "b": "Others", "c": "Others", "d": ""}
    figures = tuple(replace(figure("bars", name), fold=fold) for name, fold in folds.items())
    text = report.page([Study("one", "One", (), figures, {}, "")])
    marks = ("one-a", '<details class="fold"><summary>Others', "one-b", "one-c", "one-d")
    places = [
        text.index(mark if "<" in mark else f'<figure class="bars" id="{mark}"') for mark in marks
    ]
    assert places == sorted(places) and text.count("<details") == 1
    assert places[3] < text.index("</details>") < places[4] and Page(text).open == []


@pytest.mark.slow
def test_drawings_repeat_and_take_the_colour_of_the_page() -> None:
    for one in studies()[0].figures[:5]:  # one of a kind
        first = drawing.svg(one)
        assert first == drawing.svg(one)
        assert "currentColor" in first and "#010203" not in first
        assert first.startswith("<svg") and "<metadata" not in first


@pytest.mark.parametrize("kind", ["roc", "polar", "bars", "map", "lines"])
def test_a_figure_of_nothing_can_be_drawn(kind: Kind) -> None:
    empty = (np.empty(0), np.empty(0))
    assert drawing.svg(Figure("f", "F", kind, {"map": empty, "a": empty})).startswith("<svg")
    assert drawing.svg(Figure("f", "F", kind, {})).startswith("<svg")


@pytest.mark.slow
def test_tables_lie_beside_the_report(text: str, tmp_path: Path) -> None:
    report.write(tmp_path / "out", studies())
    names = sorted(path.name for path in (tmp_path / "out" / "tables").iterdir())
    assert names == sorted(
        f"one-{t}.{s}" for t in ("ours", "theirs", "long") for s in ("csv", "tex")
    )
    assert (tmp_path / "out" / "report.html").read_text("utf-8") == text
