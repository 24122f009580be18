"""Shared by the tests of the command line."""

from __future__ import annotations

import pytest
from samples.walk import ALL, Site, run, written


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """A recording of a walk, and its map."""
    root = tmp_path_factory.mktemp("site")
    folder, file = written(root / "run", most=ALL), root / "site.segmap"
    assert run("map", "build", folder, "--poses", "poses.tum", "--out", file) == 0
    return Site(folder, file)
