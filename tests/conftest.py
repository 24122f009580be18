"""Shared by the tests: real scans where they are at hand, and a small scene that needs nothing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings
from samples.marks import pytest_collection_modifyitems as pytest_collection_modifyitems
from samples.marks import pytest_ignore_collect as pytest_ignore_collect
from samples.plaza import Plaza
from samples.real import real

# No deadlines: how long an example takes says more of the machine than of the code.
settings.register_profile("usual", deadline=None)
settings.register_profile("sanitized", deadline=None, max_examples=20)  # several times slower
settings.load_profile("sanitized" if "SEGLOC_NATIVE" in os.environ else "usual")


@pytest.fixture(scope="session")
def kitti() -> Path:
    """The folder with KITTI 00 as LAZ scans and TUM poses."""
    pytest.importorskip("laspy")
    return real("kitti00")


@pytest.fixture(scope="session")
def plaza() -> Plaza:
    return Plaza(0)
