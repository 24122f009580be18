"""Shared by the tests of the command line."""

from __future__ import annotations

import pytest
from samples.walk import Site, walked_site


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """A recording of a walk, and its map."""
    return walked_site(tmp_path_factory.mktemp("site"))
