"""Maps that know where on the globe they lie, and GNSS fixes as priors in them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.datasets import bag_writer
from samples.maps import town
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, Localizer, SegmentMap, geometry
from segloc.errors import ConfigError, DatasetError, MapFormatError, MapMismatch, MissingDependency
from segloc.joining.same_place import check_same_place
from segloc.map.compact import CompactConfig, compacted
from segloc.map.georeference import KEY, Georeference
from segloc.map.segment_map import along
from segloc.tiles import TiledMap, cut_tiles
from segloc.tools.batch.run import LONGEST_GAP_S, gnss_priors, localize_sequence
from segloc.tools.datasets.fixes import Fixes, read_fixes
from segloc.tools.export import export
from segloc.tools.export.formats import Options

GEO = Config.preset("geo").model_copy(update={"threads": 1})
HERE = Georeference(25832, (691_600.25, 5_336_000.5, 520.0))
"""In Munich."""


def test_it_is_kept_whatever_becomes_of_the_map(tmp_path: Path) -> None:
    made = compacted(town(count=300, points=2000), CompactConfig())
    path = np.stack([geometry.yaw_transform(0.0, (4e5 + s, 5e6, 301.0)) for s in range(9)])
    made = along(made, path)
    made.metadata[KEY] = HERE.to_text()
    made.save(tmp_path / "site.segmap")
    loaded = SegmentMap.load(tmp_path / "site.segmap")
    other = along(made, path)
    del other.metadata[KEY]
    cut_tiles(made, tmp_path / "tiles", size_m=100.0)
    tiles = TiledMap(tmp_path / "tiles")
    for kept in (
        loaded,
        loaded.merge(loaded),
        other.merge(loaded),
        compacted(loaded, CompactConfig(bits=4)),
        tiles.coarse(),
        tiles.together(tiles.index.tiles),
    ):
        assert Georeference.of(kept.metadata) == HERE
    other.metadata[KEY] = Georeference(25833, HERE.origin_m).to_text()
    with pytest.raises(MapMismatch, match=r"EPSG:25832.*EPSG:25833"):
        check_same_place(made, other)
    with pytest.raises(MapFormatError, match="georeference"):
        Georeference.of(made.merge(other).metadata)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"epsg": 25832}', '{"epsg":0,"origin_m":[1,2,3]}']
)
def test_what_is_none_is_refused(text: str) -> None:
    with pytest.raises(MapFormatError, match="georeference"):
        Georeference.of({KEY: text})
    assert Georeference.of({}) is None
    with pytest.raises(ConfigError):
        Georeference(25832, (float("nan"), 0.0, 0.0))


def test_without_pyproj_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyproj", None)
    with pytest.raises(MissingDependency, match=r"\(extra geo\): pip install 'pyproj"):
        Georeference(31466).on_globe(np.zeros((1, 3)))


def test_there_and_back_to_the_tenth_of_a_millimetre() -> None:
    pytest.importorskip("pyproj")
    # The tower of Munich's Frauenkirche lies at 48.1386 N, 11.5733 E: zone 32, east of its middle.
    xyz = HERE.in_map(np.array([[11.5733, 48.1386, 520.0]]))
    assert np.abs(xyz[0, :2]).max() < 2000.0
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-5e4, 5e4, (200, 3))
    back = HERE.in_map(HERE.on_globe(xyz))
    assert np.abs(back - xyz).max() < 1e-4
    for code, fault in ((4326, "not a projected frame"), (999_999, "unknown to pyproj")):
        with pytest.raises(ConfigError, match=fault):
            Georeference(code).in_map(np.zeros((1, 3)))


def test_geojson_is_in_degrees(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    path = np.stack([geometry.yaw_transform(0.0, (s, 2.0 * s, 1.5)) for s in range(9)])
    made = along(compacted(town(count=300, points=2000), CompactConfig()), path)
    made.metadata[KEY] = HERE.to_text()
    made.save(tmp_path / "site.segmap")
    export(tmp_path / "site.segmap", "geojson", tmp_path / "a.geojson", Options())
    document = json.loads((tmp_path / "a.geojson").read_text())
    assert "crs" not in document
    (line,) = document["features"][0]["geometry"]["coordinates"]
    np.testing.assert_allclose(HERE.in_map(np.array(line)), path[:, :3, 3], atol=2e-3)


def fixes_at(xy: Any, stamps: Any, error_m: float = 2.0) -> Fixes:
    xyz = np.column_stack([np.asarray(xy, np.float64), np.full(len(stamps), 3.0)])
    degrees = HERE.on_globe(xyz)
    return Fixes("/fix", np.asarray(stamps, np.float64), degrees, np.full(len(stamps), error_m))


def test_a_query_has_the_nearest_fix_in_time() -> None:
    pytest.importorskip("pyproj")
    fixes = fixes_at([[0, 0], [10, 0], [20, 0], [90, 0]], [100.0, 101.0, 102.0, 110.0])
    stamps = np.array([99.0, 100.4, 100.6, 105.9, 110.0 + LONGEST_GAP_S + 0.1])
    priors = gnss_priors(fixes, HERE, stamps, 25.0)
    assert [None if p is None else round(p.position[0]) for p in priors] == [0, 0, 10, None, None]
    assert priors[0].radius_m == pytest.approx(31.0) and priors[0].anywhere
    unsaid = fixes_at([[0, 0]], [100.0], float("nan"))
    (prior,) = gnss_priors(unsaid, HERE, np.array([100.0]), 25.0)
    assert prior is not None and prior.radius_m == pytest.approx(55.0)
    assert gnss_priors(fixes_at([[0, 0]], [1.0], 9e9), HERE, np.array([1.0]), 25.0) == [None]
    lost = Fixes("/fix", np.ones(1), np.array([[11.0, 95.0, 0.0]]), np.ones(1))
    assert gnss_priors(lost, HERE, np.ones(1), 25.0) == [None]
    (wide,) = gnss_priors(fixes, HERE, np.array([100.0]), 2000.0)  # all of the given radius
    assert wide is not None and wide.radius_m == pytest.approx(2006.0)
    with pytest.raises(ConfigError, match="the radius must be above 0"):
        gnss_priors(fixes, HERE, stamps, -2.0)
    with pytest.raises(DatasetError, match="no stamps"):
        gnss_priors(fixes, HERE, None, 25.0)


@pytest.mark.slow
def test_wrong_fixes_are_survived(plaza: Plaza, plaza_map: SegmentMap) -> None:
    pytest.importorskip("pyproj")
    drive = PlazaSequence(plaza, steps=6)
    localizer = Localizer(plaza_map)
    positions = np.array([2, 4])
    near = localize_sequence(localizer, drive, positions)
    for off in (0.0, 3000.0):
        fixes = fixes_at(drive.poses[:, :2, 3] + off, drive.stamps)
        priors = gnss_priors(fixes, HERE, drive.stamps[positions], 25.0)
        assert all(prior is not None for prior in priors)
        found = localize_sequence(localizer, drive, positions, near=priors)
        for a, b in zip(found, near, strict=True):
            assert a.localized and b.localized
            assert np.allclose(a.T_map_sensor, b.T_map_sensor, atol=0.05)
    with pytest.raises(ConfigError, match="1 priors for 2 queries"):
        localize_sequence(localizer, drive, positions, near=priors[:1])


@pytest.mark.ros
@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_fixes_of_a_bag(kind: str, tmp_path: Path) -> None:
    writer = bag_writer(kind)
    for k in range(5):
        variance = (4.0, 9.0) if k else None
        writer.fix("/gps/fix", 50.0 + k, (48.1, 11.5 + 1e-5 * k, 520.0), variance)
    writer.fix("/gps/fix", 56.0, (48.1, 11.5, 0.0), None, status=-1)
    writer.fix("/gps/fix", 57.0, (float("nan"), 11.5, 0.0), None)
    path = writer.write(tmp_path / "run")
    fixes = read_fixes(path)
    assert fixes.source == "/gps/fix"
    np.testing.assert_allclose(fixes.stamps, 50.0 + np.arange(5))
    np.testing.assert_allclose(fixes.degrees[:, 0], 11.5 + 1e-5 * np.arange(5), rtol=1e-12)
    np.testing.assert_array_equal(np.isnan(fixes.error_m), [True, *[False] * 4])
    np.testing.assert_allclose(fixes.error_m[1:], 3.0)
    with pytest.raises(DatasetError, match="/other; available: /gps/fix"):
        read_fixes(path, "/other")
    with pytest.raises(DatasetError, match="not a bag"):
        read_fixes(tmp_path / "scans")
