"""Shared by the tests: real scans where they are at hand, and a small scene that needs nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from samples.plaza import Plaza
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
def plaza() -> Plaza:
    return Plaza(0)
