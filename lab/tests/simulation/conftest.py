"""Worlds that several tests look at."""

from __future__ import annotations

import pytest
from segloc_lab.simulation import World, town


@pytest.fixture(scope="session")
def small() -> World:
    """A town of 150 m."""
    return town(3, size_m=150.0)
