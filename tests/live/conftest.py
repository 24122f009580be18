"""Shared by the tests of online localization."""

from __future__ import annotations

import pytest

from segloc import Localizer, SegmentMap


@pytest.fixture(scope="module")
def localizer(plaza_map: SegmentMap) -> Localizer:
    return Localizer(plaza_map)
