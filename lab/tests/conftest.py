"""Shared by the tests of the laboratory."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution

import pytest
from samples.fixtures import kitti as kitti
from samples.fixtures import plaza as plaza
from samples.marks import pytest_ignore_collect as pytest_ignore_collect


@pytest.fixture(scope="session")
def verbs() -> None:
    """The verbs that the entry point adds to ``segloc``; they need the distribution installed."""
    try:
        distribution("segloc-lab")
    except PackageNotFoundError:
        pytest.skip("segloc-lab is not installed: pip install -e ./lab")
