"""Where the real scans are."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def real(*names: str) -> Path:
    """A file or folder of theirs; the test is skipped where it is not at hand."""
    path = SHARED.joinpath(*names)
    if not path.exists():
        pytest.skip(f"the real scans ../shared/data/{'/'.join(names)} are not here")
    return path
