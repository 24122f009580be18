"""The lines that documents show pass a strict type checker."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import segloc

README = Path(__file__).resolve().parents[1] / "README.md"

HEAD = """
import numpy as np
from numpy.typing import NDArray
points: NDArray[np.float32] = np.zeros((10, 3), np.float32)
"""
TAIL = """
if result.localized:
    x = float(result.T_map_sensor[0, 3])
else:
    said: str = result.reason.value + result.message
"""


@pytest.mark.slow
def test_the_readme_passes_mypy(tmp_path: Path) -> None:
    """By our own options: what `make lint` has learned of the modules is used."""
    pytest.importorskip("mypy")
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)[:1]
    (tmp_path / "readme.py").write_text(HEAD + code + TAIL)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", str(tmp_path / "readme.py")],
        cwd=README.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_all_that_is_public_is_there() -> None:
    for name in segloc.__all__:
        assert getattr(segloc, name) is not None, name
    with pytest.raises(AttributeError, match="nonesuch"):
        _ = segloc.nonesuch  # type: ignore[attr-defined]
