"""Shared by the tests of the ROS 2 packages."""

from __future__ import annotations

import pytest
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, Localizer, build_map


@pytest.fixture(scope="session")
def localizer(plaza: Plaza) -> Localizer:
    return Localizer(build_map(PlazaSequence(plaza), Config.preset("geo")))
