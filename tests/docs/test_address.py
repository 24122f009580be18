"""One command writes the repository's address and the badges."""

from __future__ import annotations

import shutil
from pathlib import Path

from samples.source import PROJECT, loaded


def test_the_address_is_replaced_everywhere_and_can_be_again(tmp_path: Path) -> None:
    address = loaded(PROJECT / "packaging" / "address.py")
    pages = ["README.md", "pyproject.toml", "CITATION.cff"]
    for name in pages:
        shutil.copy(PROJECT / name, tmp_path)
    files = [tmp_path / name for name in pages]
    old = address.address(tmp_path)
    for new in ("https://git.example.org/a/segloc", "https://git.example.org/b/segloc"):
        address.replace(tmp_path, files, new)
        for file in files:
            text = file.read_text("utf-8")
            assert new in text and old not in text
        assert (tmp_path / "README.md").read_text("utf-8").count("[![PyPI]") == 1
        old = new
