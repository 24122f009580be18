"""Maps of every released format version load, hold what they held, and localize."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml
from samples.mapfiles import assert_identical
from samples.plaza import Plaza, PlazaSequence
from samples.source import loaded

from segloc import Config, Localizer, SegmentMap, build_map
from segloc.config import map_config
from segloc.map.file import FORMAT_VERSION

FOLDER = Path(__file__).parent / "golden"
SHA256 = {
    "1-empty": "33fd55ae7e51102b46a9b079b1398ac3de7013cb86cfa488411e085bb41c0f2d",
    "1-missed": "a50cca40719bb782bc9e8f465fbce838322bc19e172839f0755761229aa862df",
    "1-plain": "dfe5d7c59ada8730169e512104d306b36e35a6b31402c600a9d90b803467e180",
    "1-quality": "5078b59b2f102343fbdf2ee891963e4ca989f258af8deaaf206df3c3c38245fa",
    "2-packed": "25b43e977ec0fa0cb56fd8efd88d7c334f0316df1d310ca8c757b2b4fd510c4e",
}


@pytest.fixture(scope="module")
def segments() -> ModuleType:
    return loaded(FOLDER / "segments.py")


def test_no_golden_map_was_written_again() -> None:
    files = {path.stem: path for path in FOLDER.glob("*.segmap")}
    found = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    assert found == SHA256
    assert {int(name.split("-")[0]) for name in found} == set(range(1, FORMAT_VERSION + 1))


@pytest.mark.parametrize("name", SHA256)
def test_it_holds_what_it_held(name: str, segments: ModuleType) -> None:
    held, made = SegmentMap.load(FOLDER / f"{name}.segmap"), segments.golden(name.split("-")[1])
    assert_identical(held, made)
    assert np.array_equal(held.missed, made.missed)
    if name != "1-empty":
        assert held.stamps[-1] == 1.5e9 + 0.25
        assert held.centroids[1].tolist() == [465_002.0, 5_251_000.0, 411.5]


def test_today_the_same_bytes_are_written(tmp_path: Path, segments: ModuleType) -> None:
    for kind in segments.KINDS:
        segments.golden(kind).save(tmp_path / "a.segmap")
        version = FORMAT_VERSION if kind == "packed" else 1
        if version > 1 and "ng" in zlib.ZLIB_RUNTIME_VERSION:
            continue  # another library deflates to other bytes
        golden = (FOLDER / f"{version}-{kind}.segmap").read_bytes()
        assert (tmp_path / "a.segmap").read_bytes() == golden, kind


def _older(config: Config) -> str:
    """A configuration with a key that is no more, and without one that has come since."""
    values = yaml.safe_load(config.to_yaml())
    values["segmentation"]["smoothness"] = 3.0
    del values["verification"]["refine"]
    return yaml.safe_dump(values)


def test_a_map_with_the_configuration_of_another_version_localizes(
    plaza: Plaza, tmp_path: Path
) -> None:
    config = Config.preset("geo").model_copy(update={"threads": 1})
    run = PlazaSequence(plaza, steps=8)
    site = build_map(run, config)
    site.metadata["config"] = _older(config)
    site.save(tmp_path / "older.segmap")
    older = SegmentMap.load(tmp_path / "older.segmap")
    assert map_config(older) == Config.preset("geo")
    result = Localizer(older).localize(plaza.scan(run.poses[7], seed=99))
    assert result.localized
    assert np.linalg.norm(result.T_map_sensor[:3, 3] - run.poses[7][:3, 3]) < 0.5
