"""The documents are easy to read, complete, and what is drawn or generated in them is true."""

from __future__ import annotations

import re
from statistics import median

import pytest
from samples.source import PROJECT

from segloc.localization import Reason

MEDIAN_WORDS = 18
README = PROJECT / "README.md"


def sentences(text: str) -> list[str]:
    """Those of the prose: without code, tables, headings and pictures; items of lists count."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = [
        line
        for line in text.splitlines()
        if line.strip() and not line.startswith(("    ", "|", "#", "!["))
    ]
    plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", " \n".join(lines))
    plain = re.sub(r"`[^`]*`", "code", plain)
    found = re.split(r"(?<=[.:?!])\s+(?=[A-Z*\[`-])|\s*\n- ", plain)
    return [each for each in found if len(each.split()) > 2]


@pytest.mark.parametrize("name", ["README.md", "docs/quickstart.md", "docs/your_data.md",
                                  "docs/refusals.md", "docs/seeing.md"])  # fmt: skip
def test_sentences_are_short(name: str) -> None:
    words = [len(each.split()) for each in sentences((PROJECT / name).read_text("utf-8"))]
    assert len(words) > 10 and median(words) < MEDIAN_WORDS, median(words)


def test_every_reason_of_a_refusal_is_explained() -> None:
    page = (PROJECT / "docs" / "refusals.md").read_text("utf-8")
    rows = re.findall(r"^\| ([a-z ]+) \| .+ \| .+ \|$", page, re.MULTILINE)
    assert {reason.value for reason in Reason} <= set(rows)


def test_pictures_are_small() -> None:
    sizes = {path.name: path.stat().st_size for path in (PROJECT / "docs/images").glob("*.*p*g")}
    moving = (PROJECT / "docs" / "images" / "tracker.webp").stat().st_size
    assert moving < 1_000_000 and max(sizes.values()) < 500_000


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    yaml = pytest.importorskip("yaml")
    text = (PROJECT / "mkdocs.yml").read_text("utf-8")
    listed = set(re.findall(r": ([\w./-]+\.md)$", text, re.MULTILINE))
    assert yaml.safe_load(re.sub(r"!!python\S+", "", text))["nav"]
    pages = {path.name for path in (PROJECT / "docs").glob("*.md")}
    assert pages <= listed
