"""Maps in tiles: nothing is lost in cutting, what fails is named, and places are found in them."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.maps import repeated, town
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, Localizer, Prior, Reason, SegmentMap, build_map, geometry
from segloc.errors import ConfigError, MapFormatError, SeglocError
from segloc.map.compact import CompactConfig, compacted
from segloc.map.parts import along
from segloc.tiles import TiledMap, cut_tiles
from segloc.tiles.index import INDEX
from segloc.tiles.store import Folder, within

GEO = Config.preset("geo").model_copy(update={"threads": 1})
TRUE = geometry.yaw_transform(1.0, (3.0, -2.0, 1.7))
AWAY = np.array([[400.0, 0, 0], [0, 400.0, 0], [800.0, 800.0, 0], [-400.0, 0, 0], [400.0, 400, 0]])


def street() -> SegmentMap:
    """A compact map with a path through it."""
    made = compacted(town(count=2700, points=20_000), CompactConfig())
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
    assert sorted(map(bytes, joined.trajectory)) == sorted(map(bytes, whole.trajectory))
    coarse = tiles.coarse()
    assert 0 < len(coarse) < len(whole) and len(coarse.cloud) == 0
    assert len(coarse.trajectory) == len(whole.trajectory)


def test_cutting_again_replaces_what_changed_alone(whole: SegmentMap, cut: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in cut.iterdir()}
    opened = TiledMap(cut)
    cut_tiles(whole, cut, size_m=50.0, margin_m=20.0)
    after = {path.name: path.stat().st_mtime_ns for path in cut.iterdir()}
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
    assert files == {index.coarse.file, *(tile.file for tile in index.tiles)}


def test_a_cut_that_fails_leaves_the_old_tiles(
    whole: SegmentMap, cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (cut / INDEX).read_bytes()
    plain = Folder.write

    def fail(self: Folder, name: str, data: bytes) -> None:
        if name == INDEX:
            raise SeglocError("disk full")
        plain(self, name, data)

    monkeypatch.setattr(Folder, "write", fail)
    with pytest.raises(SeglocError, match="disk full"):
        cut_tiles(whole.crop(whole.origin[:2], 30.0), cut, size_m=60.0, margin_m=20.0)
    assert (cut / INDEX).read_bytes() == before
    tiles = TiledMap(cut)
    assert len(tiles.together(tiles.index.tiles)) > 0.5 * len(whole)


# --- what is missing, damaged or slow -------------------------------------------------------------


@pytest.mark.parametrize("how", ["missing", "flipped", "cut short", "longer", "another"])
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
        longer = {"flipped": data, "cut short": data[:-9], "longer": data + b"0"}[how]
        path.write_bytes(bytes(longer))
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
        with pytest.raises(ConfigError, match="tiles are"):
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


def test_a_url_that_nothing_opens_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    with pytest.raises(SeglocError, match="nothing-of-that-name"):
        TiledMap("nothing-of-that-name://bucket", cache=tmp_path)


# --- localization ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(plaza: Plaza) -> SegmentMap:
    return build_map(PlazaSequence(plaza), GEO)


@pytest.mark.slow
def test_a_place_is_found_in_tiles_as_in_the_whole(
    plaza: Plaza, site: SegmentMap, tmp_path: Path
) -> None:
    cut_tiles(site, tmp_path, size_m=50.0)
    localizer, scan = Localizer(TiledMap(tmp_path)), plaza.scan(TRUE, seed=77)
    found, whole = localizer.localize(scan), Localizer(site).localize(scan)
    assert found.localized and np.allclose(found.T_map_sensor, whole.T_map_sensor, atol=0.02)
    near = localizer.localize(scan, near=((5.0, 0.0), 20.0))
    assert near.localized and np.allclose(near.T_map_sensor, whole.T_map_sensor, atol=0.02)
    wrong = localizer.localize(scan, near=((4000.0, 0.0), 20.0))
    assert wrong.reason is Reason.NOT_NEAR_PRIOR
    anywhere = localizer.localize(scan, near=Prior((4000.0, 0.0), 20.0, anywhere=True))
    assert anywhere.localized
    (tmp_path / localizer.tiles.index.tiles[0].file).unlink()
    with pytest.raises(MapFormatError, match="tile_"):
        Localizer(TiledMap(tmp_path)).localize(scan)


@pytest.mark.slow
def test_ambiguity_spans_tiles(plaza: Plaza, site: SegmentMap, tmp_path: Path) -> None:
    many = repeated(site, *AWAY)
    index = cut_tiles(many, tmp_path, size_m=200.0)
    localizer, scan = Localizer(TiledMap(tmp_path)), plaza.scan(TRUE, seed=77)
    assert len(index.tiles) > 10
    assert localizer.localize(scan).reason is Reason.AMBIGUOUS
    for shift in AWAY:
        found = localizer.localize(scan, near=(TRUE[:2, 3] + shift[:2] + 8.0, 30.0))
        assert found.localized, found.message
        assert np.linalg.norm(found.T_map_sensor[:3, 3] - TRUE[:3, 3] - shift) < 0.3


@pytest.mark.slow
def test_the_verbs_cut_and_localize(
    plaza: Plaza, site: SegmentMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from segloc import cli

    site.save(tmp_path / "site.segmap")
    scans = tmp_path / "scans"
    scans.mkdir()
    np.save(scans / "0.npy", plaza.scan(TRUE, seed=77).points)
    monkeypatch.chdir(tmp_path)
    for line in (
        "map tile site.segmap --size 50 --out tiles",
        "localize scans --map tiles --near 3,-2 --radius 20 --out found --threads 1",
        "localize scans --map tiles --near 300,-2 --radius 20 --out lost --threads 1",
    ):
        monkeypatch.setattr("sys.argv", ["segloc", *line.split()])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert not end.value.code, capsys.readouterr().err
    files = (tmp_path / name / "localizations.jsonl" for name in ("found", "lost"))
    answers = [json.loads(file.read_text()) for file in files]
    assert answers[0]["localized"] and answers[1]["reason"] == "not near the prior"
