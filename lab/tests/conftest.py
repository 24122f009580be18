"""Shared by the tests of the experiments."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from samples.marks import pytest_ignore_collect as pytest_ignore_collect
from samples.real import SHARED


@pytest.fixture(scope="session")
def kitti() -> Path:
    """The folder with KITTI 00 as LAZ scans and TUM poses."""
    pytest.importorskip("laspy")
    folder = SHARED / "kitti00"
    if not folder.is_dir():
        pytest.skip("the real scans (../shared/data/kitti00) are not here")
    return folder


@pytest.fixture(scope="session")
def verbs() -> None:
    """The verbs that the entry point adds to ``segloc``; they need the distribution installed."""
    try:
        distribution("segloc-lab")
    except PackageNotFoundError:
        pytest.skip("segloc-lab is not installed: pip install -e ./experiments")
