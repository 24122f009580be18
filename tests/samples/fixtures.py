"""Fixtures of all tests, those of the laboratory included."""

from __future__ import annotations

from pathlib import Path

import pytest

from segloc import Config, Localizer, SegmentMap, build_map

from .plaza import Plaza, PlazaSequence
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


@pytest.fixture(scope="session")
def plaza_map(plaza: Plaza) -> SegmentMap:
    """A map of the plaza by ``geo``; tests that change it copy it first."""
    config = Config.preset("geo").model_copy(update={"threads": 1})
    return build_map(PlazaSequence(plaza), config)


@pytest.fixture(scope="session")
def localizer(plaza_map: SegmentMap) -> Localizer:
    """In that map."""
    return Localizer(plaza_map)
