"""Maps in tiles: nothing is lost in cutting, what fails is named, and places are found in them."""

from __future__ import annotations

import dataclasses
import json
import pickle
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.maps import repeated, town
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, Localizer, Prior, Reason, SegmentMap, Tracker, build_map, geometry
from segloc.errors import ConfigError, MapFormatError, MapMismatch, SeglocError
from segloc.joining.update import update_map
from segloc.map.compact import CompactConfig, compacted
from segloc.map.config import MappingConfig
from segloc.map.segment_map import along, part_where, with_parts
from segloc.tiles import (
    TiledLocalizer,
    TiledMap,
    cut_tiles,
    merge_into_tiles,
    tiled_map,
    update_tiles,
)
from segloc.tiles.cut import in_square
from segloc.tiles.index import INDEX
from segloc.tiles.store import Folder, Remote, within
from segloc.tracker import TrackerConfig

GEO = Config.preset("geo").model_copy(update={"threads": 1})
TRUE = geometry.yaw_transform(1.0, (3.0, -2.0, 1.7))
AWAY = np.array([[400.0, 0, 0], [0, 400.0, 0], [800.0, 800.0, 0], [-400.0, 0, 0], [400.0, 400, 0]])


def street() -> SegmentMap:
    """A compact map with a path through it."""
    made = compacted(town(count=1350, points=10_000), CompactConfig())
    steps = np.linspace(-59, 59, 60)
    path = [geometry.yaw_transform(0.0, (4e5 + s, 5e6 + s, 301.0)) for s in steps]
    return along(made, np.stack(path))


@pytest.fixture(scope="module")
def whole() -> SegmentMap:
    return street()


@pytest.fixture()
def cut(whole: SegmentMap, tmp_path: Path) -> Path:
    cut_tiles(whole, tmp_path / "tiles", size_m=50.0, margin_m=20.0)
    return tmp_path / "tiles"


def rows(prior_map: SegmentMap) -> list[Any]:
    columns = [prior_map.centroids, prior_map.vectors, prior_map.stamps, prior_map.session]
    return sorted(map(tuple, np.column_stack(columns).tolist()))


def test_tiles_together_are_the_map_that_was_cut(whole: SegmentMap, cut: Path) -> None:
    tiles = TiledMap(cut)
    assert len(tiles) == len({tile.cell for tile in tiles.index.tiles}) > 2
    joined = tiles.together(tiles.index.tiles)
    reach = np.zeros(len(whole), dtype=bool)
    for tile in tiles.index.tiles:
        low = np.array(tile.cell) * 50.0 - 20.0
        inside = (whole.centroids[:, :2] >= low) & (whole.centroids[:, :2] < low + 90.0)
        reach |= inside.all(axis=1)
        assert tile.segments == len(tiles.tile(tile))
    assert rows(joined) == rows(whole.kept(reach, np.ones(len(whole.cloud), bool)))
    points = {p.tobytes() for p in whole.cloud}
    assert len(joined.cloud) > 0.5 * len(whole.cloud)
    assert all(p.tobytes() in points for p in joined.cloud)
    voxels = np.floor((joined.cloud + joined.origin) / joined.cloud_voxel)
    assert len(np.unique(voxels, axis=0)) == len(joined.cloud)  # what two tiles hold is there once
    assert sorted(map(bytes, joined.trajectory)) == sorted(map(bytes, whole.trajectory))
    coarse = tiles.coarse()
    assert 0 < len(coarse) < len(whole) and len(coarse.cloud) == 0
    assert len(coarse.trajectory) == len(whole.trajectory)


def test_whoever_cuts_it_is_the_same(whole: SegmentMap, cut: Path, tmp_path: Path) -> None:
    with ThreadPoolExecutor(3) as threads:
        cut_tiles(whole, tmp_path / "again", size_m=50.0, margin_m=20.0, executor=threads)
    for path in cut.glob("*.segmap"):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()
    tile = TiledMap(cut).index.tiles[0]
    alone = along(whole, whole.trajectory[in_square(whole.trajectory[:, :3, 3], tile.cell, 50.0)])
    only = cut_tiles(alone, tmp_path / "one", size_m=50.0, margin_m=20.0)
    assert [(t.cell, t.segments) for t in only.tiles] == [(tile.cell, tile.segments)]


def test_cutting_again_replaces_what_changed_alone(whole: SegmentMap, cut: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in cut.iterdir()}
    opened, others = TiledMap(cut), ("tile_roof.segmap", "coarse-2025.segmap", "tile_0_0.segmap")
    for name in others:
        whole.save(cut / name)
    cut_tiles(whole, cut, size_m=50.0, margin_m=20.0)
    after = {path.name: path.stat().st_mtime_ns for path in cut.iterdir() if path.name in before}
    assert {n: t for n, t in before.items() if n != INDEX} == {
        n: t for n, t in after.items() if n != INDEX
    }
    corner = np.abs(whole.centroids[:, :2] - whole.centroids[:, :2].max(axis=0)).max(axis=1)
    changed = whole.kept(corner > 25.0, np.ones(len(whole.cloud), dtype=bool))
    index = cut_tiles(changed, cut, size_m=50.0, margin_m=20.0)
    same = {tile.file for tile in index.tiles} & set(before)
    assert 0 < len(same) < len(index.tiles)
    assert len(opened.together(opened.index.tiles)) > len(changed) / 2  # old files are still there
    cut_tiles(changed, cut, size_m=50.0, margin_m=20.0)
    files = {path.name for path in cut.iterdir() if path.suffix == ".segmap"}
    assert files == {index.coarse.file, *(tile.file for tile in index.tiles), *others}


# --- what is missing, damaged or slow -------------------------------------------------------------


@pytest.mark.parametrize("how", ["missing", "flipped", "truncated", "another"])
def test_a_tile_that_cannot_be_had_is_named(cut: Path, how: str) -> None:
    tiles = TiledMap(cut)
    first, second, *_ = tiles.index.tiles
    path = cut / first.file
    data = bytearray(path.read_bytes())
    if how == "missing":
        path.unlink()
    elif how == "another":
        path.write_bytes((cut / second.file).read_bytes())
    else:
        data[len(data) // 2] ^= 4
        path.write_bytes(bytes(data if how == "flipped" else data[:-9]))
    with pytest.raises(MapFormatError, match=first.file) as caught:
        tiles.together(tiles.index.tiles)
    assert "\n" not in str(caught.value)
    assert len(tiles.tile(second)) == second.segments  # the others are as they were


def test_a_store_that_does_not_answer_is_named(cut: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiles = TiledMap(cut, timeout_s=0.2)
    monkeypatch.setattr(Folder, "read", lambda *_: time.sleep(30))
    with pytest.raises(MapFormatError, match=r"segmap: no answer within 0\.2 s"):
        tiles.tile(tiles.index.tiles[0])
    assert within(5.0, lambda: 7) == 7


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda i: i.pop("tiles"), "tiles"),
        (lambda i: i.update(version=99), "newer"),
        (lambda i: i.update(extra=1), "extra"),
        (lambda i: i.update(size_m=-1), "size_m"),
        (lambda i: i["tiles"][0].update(file="../../etc/passwd"), "file"),
        (lambda i: i["tiles"][0].update(file="/dev/zero"), "file"),
        (lambda i: i["tiles"][0].update(bytes=2**60), "bytes"),
        (lambda i: i["tiles"][0].update(digest="0"), "digest"),
        (lambda i: i["tiles"][0].update(cell=[2**40, 0]), "cell"),
        (lambda i: i["tiles"].append(i["tiles"][0]), "two tiles"),
    ],
)
def test_a_damaged_index_is_refused(cut: Path, change: Any, fault: str) -> None:
    index = json.loads((cut / INDEX).read_text())
    change(index)
    (cut / INDEX).write_text(json.dumps(index))
    with pytest.raises(MapFormatError, match=fault) as caught:
        TiledMap(cut)
    assert INDEX in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_no_place_of_tiles_is_refused(tmp_path: Path, whole: SegmentMap) -> None:
    for name, text in (("none", None), ("noise", b"\xff\0"), ("deep", b"[" * 99_999)):
        folder = tmp_path / name
        folder.mkdir()
        if text is not None:
            (folder / INDEX).write_bytes(text)
        with pytest.raises(MapFormatError, match=INDEX):
            TiledMap(folder)
    for size, margin in ((1.0, 0.0), (np.nan, 0.0), (100.0, 2000.0), (100.0, -1.0)):
        with pytest.raises(ConfigError, match="tiles must be"):
            cut_tiles(whole, tmp_path / "x", size_m=size, margin_m=margin)
    with pytest.raises(SeglocError, match="no tiles"):
        cut_tiles(SegmentMap.empty("geo", "f", 7), tmp_path / "x")


# --- behind a URL ---------------------------------------------------------------------------------


def test_tiles_behind_a_url_are_kept_on_the_disk(whole: SegmentMap, tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    url = "memory://segloc-test/tiles"
    cut_tiles(whole, url, size_m=50.0, margin_m=20.0)
    cache = tmp_path / "cache"
    tiles = TiledMap(url, cache=cache)
    joined = tiles.together(tiles.index.tiles)
    assert {path.name for path in cache.iterdir()} == {tile.file for tile in tiles.index.tiles}
    store = fsspec.filesystem("memory")
    first = tiles.index.tiles[0]
    store.rm_file(f"/segloc-test/tiles/{first.file}")
    again = TiledMap(url, cache=cache)
    assert rows(again.together(again.index.tiles)) == rows(joined)  # from the copies
    (cache / first.file).write_bytes(b"damaged")
    with pytest.raises(MapFormatError, match=f"{first.file}: no such file"):
        TiledMap(url, cache=cache).tile(first)
    store.rm("/segloc-test", recursive=True)
    with pytest.raises(MapFormatError, match=INDEX):
        TiledMap(url, cache=cache)


def test_the_cache_is_bounded(whole: SegmentMap, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    url = "memory://segloc-bounded"
    index = cut_tiles(whole, url, size_m=50.0, margin_m=20.0)
    most = int(1.5 * max(tile.bytes for tile in index.tiles))
    tiles = TiledMap(url, cache=tmp_path / "cache", cache_bytes=most)
    for tile in index.tiles:
        tiles.tile(tile)
        assert sum(p.stat().st_size for p in (tmp_path / "cache").iterdir()) <= most
        assert (tmp_path / "cache" / tile.file).exists()


class Faulty:
    """A store whose first answers for tiles are late or wrong."""

    def __init__(self, where: str, how: str, times: int) -> None:
        self._store, self._how, self._left = Remote(where), how, times
        self.where = where

    def read(self, name: str, most: int) -> bytes:
        data = self._store.read(name, most)
        if name == INDEX or not self._left:
            return data
        self._left -= 1
        if self._how == "late":
            time.sleep(30)
        if self._how == "error":
            raise ConnectionResetError("connection reset by peer")
        return data[::-1]


@pytest.mark.parametrize("how", ["late", "error", "wrong"])
def test_a_faulty_store_is_asked_twice_and_then_named(
    whole: SegmentMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    pytest.importorskip("fsspec")
    url = f"memory://segloc-faulty-{how}"
    index = cut_tiles(whole, url, size_m=50.0, margin_m=20.0)
    first, second, *_ = index.tiles
    for times, works in ((1, False),) if how == "late" else ((1, True), (2, False)):
        store = Faulty(url, how, times)
        monkeypatch.setattr(tiled_map, "store_of", lambda _, store=store: store)
        tiles = TiledMap(url, cache=tmp_path / f"{times}", timeout_s=0.5)
        if works:
            assert len(tiles.tile(first)) == first.segments
            continue
        with pytest.raises(MapFormatError, match=first.file) as caught:
            tiles.tile(first)
        assert "\n" not in str(caught.value)
        assert len(tiles.tile(second)) == second.segments
        assert len(tiles.tile(first)) == first.segments  # once it answers


def test_what_was_used_last_or_takes_long_is_kept_within_its_bytes(cut: Path) -> None:
    made: list[int] = []

    def kept_of(seconds: dict[int, float], keys: Sequence[int]) -> tiled_map.Recent:
        now = 0.0

        def make(key: int) -> int:
            nonlocal now
            made.append(key)
            now += seconds.get(key, 1.0)
            return key

        made.clear()
        recent = tiled_map.Recent(100, lambda: now)
        assert [recent.get(k, partial(make, k), lambda _: 40) for k in keys] == list(keys)
        return recent

    recent = kept_of({}, (1, 2, 1, 3, 2, 1))
    assert made == [1, 2, 3, 2, 1] and recent.bytes == 80  # 2 went for 3, 1 for 2, and 3 for 1
    kept_of({1: 3.5}, (1, 2, 3, 1))
    assert made == [1, 2, 3]  # 2 went for 3, though 1 was used before
    kept_of({1: 3.5}, (1, 2, 3, 2, 3, 2, 1))
    assert made == [1, 2, 3, 2, 3, 2, 1]  # but it is not kept for ever
    tiles = TiledMap(cut, memory_bytes=1)
    for tile in tiles.index.tiles:
        assert tiles.tile(tile) is tiles.tile(tile)
    assert len(tiles.recent) == 1


# --- changing them --------------------------------------------------------------------------------


def test_a_merge_writes_the_tiles_that_it_reaches(whole: SegmentMap, tmp_path: Path) -> None:
    """And gives what cutting the merged map gives."""
    low = whole.origin[:2] + whole.cloud[:, :2].min(axis=0)
    other = session_of(whole, low + 20.0, 25.0)
    cut_tiles(whole, tmp_path / "merged", size_m=50.0, margin_m=20.0)
    before = TiledMap(tmp_path / "merged").index
    changed = merge_into_tiles(tmp_path / "merged", other, elsewhere=True)
    assert 0 < changed.written < len(changed.index.tiles)
    same = {tile.file for tile in before.tiles} & {tile.file for tile in changed.index.tiles}
    assert len(same) == len(changed.index.tiles) - changed.written
    together = compacted(whole.merge(other), CompactConfig())
    cut_tiles(together, tmp_path / "cut", size_m=50.0, margin_m=20.0)
    found, expected = TiledMap(tmp_path / "merged"), TiledMap(tmp_path / "cut")
    assert [t.cell for t in found.index.tiles] == [t.cell for t in expected.index.tiles]
    assert rows(found.together(found.index.tiles)) == rows(expected.together(expected.index.tiles))
    assert len(found.coarse().trajectory) == len(expected.coarse().trajectory)


def test_a_map_of_coarser_voxels_is_not_merged(cut: Path, plaza: Plaza) -> None:
    before = {path.name for path in cut.iterdir()}
    config = Config.preset("geo").model_copy(update={"mapping": MappingConfig(cloud_voxel=0.6)})
    coarse = build_map(PlazaSequence(plaza, steps=4), config)
    with pytest.raises(MapMismatch, match=r"0\.6 m, .* build it with mapping\.cloud_voxel: 0\.3"):
        merge_into_tiles(cut, coarse, unchecked=True)
    assert {path.name for path in cut.iterdir()} == before


def test_a_change_that_fails_leaves_the_tiles(
    whole: SegmentMap, cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path.name: path.read_bytes() for path in cut.iterdir()}
    plain = Folder.write

    def fail(self: Folder, name: str, data: bytes) -> None:
        if name == INDEX:
            raise SeglocError("disk full")
        plain(self, name, data)

    monkeypatch.setattr(Folder, "write", fail)
    other = session_of(whole, whole.origin[:2], 25.0)
    with pytest.raises(SeglocError, match="disk full"):
        merge_into_tiles(cut, other, elsewhere=True)
    assert {name: (cut / name).read_bytes() for name in before} == before
    far = along(other, other.trajectory + np.array([[0, 0, 0, 9e4]] * 2 + [[0] * 4] * 2))
    with pytest.raises(SeglocError):
        merge_into_tiles(cut, far)


@pytest.mark.parametrize("where", ["folder", "memory://segloc-writers"])
def test_of_several_writers_none_is_lost(whole: SegmentMap, tmp_path: Path, where: str) -> None:
    if "://" in where:
        pytest.importorskip("fsspec")
    place = where if "://" in where else str(tmp_path / where)
    cut_tiles(whole, place, size_m=50.0, margin_m=20.0)
    extent = whole.origin[:2] + whole.cloud[:, :2].mean(axis=0)
    others = [session_of(whole, extent + 6.0 * k, 15.0, 0.25 + 0.1 * k) for k in range(3)]
    with ThreadPoolExecutor(3) as threads:
        list(threads.map(lambda other: merge_into_tiles(place, other, elsewhere=True), others))
    tiles = TiledMap(place, cache=tmp_path / "cache")
    joined = tiles.together(tiles.index.tiles)
    assert len(np.unique(joined.session)) == len(np.unique(whole.session)) + len(others)


def session_of(whole: SegmentMap, centre: Any, radius: float, aside: float = 0.25) -> SegmentMap:
    """What another session saw around a place: the same objects, a little elsewhere."""
    part = whole.crop(centre, radius)
    columns = part.columns()
    columns["centroids"] = part.centroids + aside
    columns["stamps"] = part.stamps + 1e5 * aside
    columns["session"] = np.zeros(len(part), np.int32)
    columns["missed"] = np.zeros(len(part), np.int32)
    path = np.stack([geometry.yaw_transform(0.0, (*centre, 301.0 + k)) for k in range(2)])
    return compacted(with_parts(part, segments=columns, trajectory=path), CompactConfig())


# --- localization ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_place_is_found_in_tiles_as_in_the_whole(
    plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path
) -> None:
    cut_tiles(plaza_map, tmp_path, size_m=50.0)
    localizer, scan = TiledLocalizer(TiledMap(tmp_path)), plaza.scan(TRUE, seed=77)
    found, whole = localizer.localize(scan), Localizer(plaza_map).localize(scan)
    assert found.localized and np.allclose(found.T_map_sensor, whole.T_map_sensor, atol=0.02)
    near = localizer.localize(scan, near=((5.0, 0.0), 20.0))
    assert near.localized and np.allclose(near.T_map_sensor, whole.T_map_sensor, atol=0.02)
    wrong = localizer.localize(scan, near=((4000.0, 0.0), 20.0))
    assert wrong.reason is Reason.NOT_NEAR_PRIOR
    anywhere = localizer.localize(scan, near=Prior((4000.0, 0.0), 20.0, anywhere=True))
    assert anywhere.localized
    for tile in localizer.tiles.index.tiles:
        (tmp_path / tile.file).unlink()
    with pytest.raises(MapFormatError, match="tile_"):
        TiledLocalizer(TiledMap(tmp_path)).localize(scan)


@pytest.mark.slow
def test_answers_in_tiles_are_those_of_one_map(
    plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path
) -> None:
    """Of places in the map and elsewhere."""
    cut_tiles(plaza_map, tmp_path, size_m=50.0)
    tiles = TiledMap(tmp_path, memory_bytes=1)
    assert len(tiles) > 1
    whole, localizer = Localizer(plaza_map, GEO), TiledLocalizer(tiles, GEO)
    there = geometry.yaw_transform(-2.0, (-8.0, 5.0, 1.7))
    found = 0
    for world, pose in ((plaza, TRUE), (plaza, there), (Plaza(seed=4242), TRUE)):
        scan = world.scan(pose, seed=77)
        expected, answer = whole.localize(scan), localizer.localize(scan)
        assert answer.reason is expected.reason
        if expected.localized:
            found += 1
            assert np.allclose(answer.T_map_sensor, expected.T_map_sensor, atol=0.02)
            assert abs(answer.confidence - expected.confidence) < 0.01
    assert found == 2


@pytest.mark.slow
def test_a_robot_is_followed_from_tile_to_tile(
    plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path
) -> None:
    cut_tiles(plaza_map, tmp_path, size_m=50.0)
    tiles = TiledMap(tmp_path)
    assert len(tiles) > 1
    T_map_odom = geometry.yaw_transform(2.0, (300.0, 20.0, 1.0))
    tracker = Tracker(TiledLocalizer(tiles), TrackerConfig(every_m=10.0))
    for k in range(16):
        truth = geometry.yaw_transform(0.02 * k, (-15.0 + 2 * k, 1.0, 1.8))
        scan = plaza.scan(truth, posed=False, seed=k)
        track = tracker.update(scan, geometry.inverse(T_map_odom) @ truth)
        if track.T_map_odom is not None:
            assert np.allclose(
                track.T_map_odom @ geometry.inverse(T_map_odom) @ truth, truth, atol=0.5
            )
    assert track.localized and track.views > 5


@pytest.mark.slow
def test_a_localizer_in_tiles_is_one_like_others(
    plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path
) -> None:
    cut_tiles(plaza_map, tmp_path, size_m=50.0)
    localizer, scan = TiledLocalizer(TiledMap(tmp_path), GEO), plaza.scan(TRUE, seed=77)
    again = pickle.loads(pickle.dumps(localizer))
    a, b = localizer.localize(scan), again.localize(scan)
    assert a.localized and np.array_equal(a.T_map_sensor, b.T_map_sensor)
    assert len(localizer.tiles.recent) > 0
    with pytest.raises(ConfigError, match="thorough"):
        localizer.search(localizer.describe(scan), thorough=True)


@pytest.mark.slow
def test_a_session_updates_the_tiles_that_it_reaches(
    plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path
) -> None:
    """As it does a map in one piece; what stands elsewhere is not read."""
    shift = np.array([2000.0, 0.0, 0.0])
    both = repeated(plaza_map, shift)
    session = PlazaSequence(plaza, steps=8)
    cut_tiles(both, tmp_path, size_m=50.0)
    before = {tile.cell: tile.file for tile in TiledMap(tmp_path).index.tiles}
    changed, counts = update_tiles(tmp_path, session, GEO)
    expected, whole_counts = update_map(plaza_map, session, GEO)
    assert dataclasses.replace(counts, shift=None) == dataclasses.replace(whole_counts, shift=None)
    after = TiledMap(tmp_path)
    far = {cell: file for cell, file in before.items() if cell[0] > 20}
    assert far and far.items() <= {t.cell: t.file for t in after.index.tiles}.items()
    assert 0 < changed.written <= changed.read < len(before)
    near = [tile for tile in after.index.tiles if tile.cell[0] <= 20]
    found = after.together(near)
    assert len(found) == len(expected)
    assert np.array_equal(np.sort(found.centroids, axis=0), np.sort(expected.centroids, axis=0))
    new = np.setdiff1d(found.session, both.session)
    assert len(new) == 1
    assert (
        TiledLocalizer(after, GEO).localize(plaza.scan(TRUE, seed=77), near=((0, 0), 40)).localized
    )


@pytest.mark.slow
def test_ambiguity_spans_tiles(plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path) -> None:
    many = repeated(plaza_map, *AWAY)
    index = cut_tiles(many, tmp_path, size_m=200.0)
    localizer, scan = TiledLocalizer(TiledMap(tmp_path)), plaza.scan(TRUE, seed=77)
    assert len(index.tiles) > 10
    assert localizer.localize(scan).reason is Reason.AMBIGUOUS
    for shift in AWAY:
        found = localizer.localize(scan, near=(TRUE[:2, 3] + shift[:2] + 8.0, 30.0))
        assert found.localized, found.message
        assert np.linalg.norm(found.T_map_sensor[:3, 3] - TRUE[:3, 3] - shift) < 0.3


@pytest.mark.slow
def test_of_many_tiles_few_are_fetched(plaza_map: SegmentMap, tmp_path: Path) -> None:
    """But these must be there."""
    store = pytest.importorskip("fsspec").filesystem("memory")
    url, elsewhere = "memory://segloc-nowhere", Plaza(seed=4242).scan(TRUE, seed=77)
    index = cut_tiles(repeated(plaza_map, *AWAY), url, size_m=100.0)
    answer = TiledLocalizer(TiledMap(url, cache=tmp_path)).localize(elsewhere)
    assert answer.reason is Reason.NOT_IN_MAP and answer.counts["matches"] > 0
    fetched = {path.name for path in tmp_path.iterdir()} & {tile.file for tile in index.tiles}
    assert 0 < len(fetched) <= 4 < len(index.tiles)
    for name in fetched:
        store.rm_file(f"/segloc-nowhere/{name}")
    with pytest.raises(MapFormatError, match="tile_"):
        TiledLocalizer(TiledMap(url, cache=tmp_path / "another")).localize(elsewhere)


@pytest.mark.slow
def test_a_scan_of_few_segments_is_found_in_many_tiles(
    plaza: Plaza, plaza_map: SegmentMap, tmp_path: Path
) -> None:
    """Too few segments agree to accept a tile by them; its cloud decides."""
    whole = plaza_map
    for seed, shift in enumerate(AWAY, start=1):
        other = build_map(PlazaSequence(Plaza(seed)), GEO)
        whole = whole.merge(repeated(other, shift).crop(shift[:2], 100.0))
    assert len(cut_tiles(whole, tmp_path, size_m=100.0).tiles) > 10
    points = plaza.scan(TRUE, seed=77).points
    close = points[np.linalg.norm(points[:, :2], axis=1) < 20.0]
    found = TiledLocalizer(TiledMap(tmp_path), GEO).localize(close)
    assert found.localized and found.counts["segments"] < 10
    assert np.allclose(found.T_map_sensor, TRUE, atol=0.3)


def test_a_map_without_a_trajectory_is_merged_whole(whole: SegmentMap, tmp_path: Path) -> None:
    middle = float(np.median(whole.centroids[:, 0]))
    left = part_where(whole, lambda places: places[:, 0] < middle)
    right = along(part_where(whole, lambda places: places[:, 0] >= middle), np.empty((0, 4, 4)))
    cut_tiles(left, tmp_path / "tiles", size_m=50.0, margin_m=20.0)
    merge_into_tiles(tmp_path / "tiles", right, unchecked=True)
    tiles = TiledMap(tmp_path / "tiles")
    joined = {row.tobytes() for row in tiles.together(tiles.index.tiles).centroids}
    assert {row.tobytes() for row in right.centroids} <= joined


def test_a_damaged_tile_is_written_again(whole: SegmentMap, cut: Path) -> None:
    tile = TiledMap(cut).index.tiles[0]
    file = cut / tile.file
    file.write_bytes(file.read_bytes()[:-5])
    cut_tiles(whole, cut, size_m=50.0, margin_m=20.0)
    assert len(TiledMap(cut).tile(tile)) == tile.segments


def test_a_place_that_cannot_be_written_is_one_line(whole: SegmentMap, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "tiles", "http://127.0.0.1:9/tiles"):
        with pytest.raises(SeglocError, match="cannot be"):
            cut_tiles(whole, out, size_m=50.0, margin_m=20.0)
