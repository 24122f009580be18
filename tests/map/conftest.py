"""A place that commands write maps of."""

from __future__ import annotations

from pathlib import Path

import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.walk import as_folder

from segloc import Config, build_map
from segloc.types import as_recording


@pytest.fixture(scope="package")
def place(tmp_path_factory: pytest.TempPathFactory, plaza: Plaza) -> Path:
    """A map of a plaza, and two sessions there as folders of scans with poses."""
    folder, walk = tmp_path_factory.mktemp("place"), PlazaSequence(plaza, steps=6)
    config = Config.preset("geo").model_copy(update={"threads": 1})
    build_map(walk, config).save(folder / "site.segmap")
    for name, seed in (("one", 100), ("two", 200)):
        scans = [plaza.scan(T, seed=seed + i) for i, T in enumerate(walk.poses)]
        as_folder(folder / name, as_recording(scans))
    return folder
