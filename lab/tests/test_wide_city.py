"""A thin map among copies of itself: of the requested size, and queries are still found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from segloc_lab.bench import harness
from segloc_lab.city import widened

from segloc import Config, Scan, build_map
from segloc.tiles import TiledLocalizer, TiledMap, cut_tiles

TIMES = 3


@pytest.fixture(scope="module")
def walk() -> harness.PlazaWalk:
    return harness.PlazaWalk(harness.Plaza(), steps=6)


@pytest.fixture(scope="module")
def tiles(walk: harness.PlazaWalk, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("city") / "tiles"
    cut_tiles(build_map(walk, Config(threads=1)), folder, size_m=50)
    return folder


def test_queries_are_found_among_copies(walk: harness.PlazaWalk, tiles: Path) -> None:
    thin = TiledMap(tiles).coarse()
    assert widened(tiles, tiles.parent / "wide", TIMES) == TIMES * len(thin)
    wide = TiledMap(tiles.parent / "wide")
    assert len(wide.coarse()) == TIMES * len(thin)
    found = TiledLocalizer(wide, Config(threads=1)).localize(Scan(walk.scan(3).points))
    assert found.T_map_sensor is not None
    assert np.linalg.norm(found.T_map_sensor[:3, 3] - walk.poses[3, :3, 3]) < 0.3
