"""One version, wherever it is written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = (ROOT / "pyproject.toml").read_text("utf-8")


def found(pattern: str, text: str) -> str:
    match = re.search(pattern, text, re.MULTILINE)
    assert match, pattern
    return match[1]


VERSION = found(r'^version = "(.+)"$', PROJECT)


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("lab/pyproject.toml", r'^version = "(.+)"$'),
        ("plugins/segloc-stems/pyproject.toml", r'^version = "(.+)"$'),
        ("CITATION.cff", r"^version: (.+)$"),
        ("packaging/conda/recipe.yaml", r"^  version: (.+)$"),
        (".zenodo.json", r'"version": "(.+)"'),
        *((str(file), "<version>(.+)<") for file in ROOT.glob("ros2/*/package.xml")),
        *((str(file), 'version="(.+?)"') for file in ROOT.glob("ros2/*/setup.py")),
    ],
)
def test_one_version_everywhere(file: str, pattern: str) -> None:
    assert found(pattern, (ROOT / file).read_text("utf-8")) == VERSION


@pytest.mark.parametrize("folder", ["lab", "plugins/segloc-stems"])
def test_other_distributions_need_the_segloc_that_they_were_made_with(folder: str) -> None:
    text = (ROOT / folder / "pyproject.toml").read_text("utf-8")
    major, minor = (int(part) for part in VERSION.split(".")[:2])
    needed = re.findall(r'"segloc(?:\[[\w,]+\])?(>.*)"', text)
    assert needed and set(needed) == {f">={major}.{minor},<{major}.{minor + 1}"}


def test_the_conda_recipe_needs_what_the_project_needs() -> None:
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text("utf-8")
    block = found(r"^  run:\n((?:    - .+\n)+)", recipe)
    ours = found(r"^dependencies = \[\n((?:  .+\n)+)\]", PROJECT)
    wanted = set(re.findall(r'"([\w-]+)>=([\d.]+)"', ours))
    assert set(re.findall(r"- ([\w-]+) >=([\d.]+)", block)) == wanted
