"""docs/architecture.md has every room, about as large as it is, and names files that exist."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_tables_are_current(generate: ModuleType) -> None:
    assert not generate.stale(PAGE), "run: python docs/generate.py"


def test_files_named_for_the_paper_exist() -> None:
    section = PAGE.partition("## The paper, section by section")[2]
    experiments = ROOT / "experiments" / "src" / "segloc_lab"
    names = re.findall(r"`((?:\w+/)+(?:\w+\.\w+)?|\w+\.py)`", section)
    assert len(names) > 40
    places = (ROOT, ROOT / "src" / "segloc", experiments)
    folders = (ROOT / "src" / "segloc" / "descriptors", ROOT / "cpp" / "descriptors")
    lost = [n for n in names if not any((p / n).exists() for p in (*places, *folders))]
    assert not lost
