"""Fixtures of all tests, those of the laboratory included."""

from __future__ import annotations

from pathlib import Path

import pytest

from .plaza import Plaza
from .real import real


@pytest.fixture(scope="session")
def kitti() -> Path:
    """The folder with KITTI 00 as LAZ scans and TUM poses."""
    pytest.importorskip("laspy")
    return real("kitti00")


@pytest.fixture(scope="session")
def plaza() -> Plaza:
    """A small scene that needs no simulator."""
    return Plaza(0)
