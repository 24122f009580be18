"""Compact maps: the numbers of a map on lattices, packed into a file, and what is kept of them."""

from __future__ import annotations

import json
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from samples.mapfiles import assert_identical, assert_refused, with_header
from samples.maps import town
from scipy.spatial import cKDTree

from segloc import SegmentMap, _native
from segloc.map import coding
from segloc.map.coding import MAX_GROWTH
from segloc.map.compact import CompactConfig, compacted
from segloc.map.config import MappingConfig

ORIGIN = np.array([4e5, 5e6, 300.0])


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> tuple[SegmentMap, bytes]:
    made, path = compacted(town(), CompactConfig()), tmp_path_factory.mktemp("map") / "a.segmap"
    made.save(path)
    return made, path.read_bytes()


# --- lattices and columns -------------------------------------------------------------------------

numbers = hnp.arrays(
    np.int64,
    st.tuples(st.integers(0, 30), st.integers(1, 4)),
    elements=st.integers(0, 2**53) | st.integers(0, 300),
)


@given(numbers)
def test_columns_come_back(codes: np.ndarray) -> None:
    width = coding.width_of(codes)
    found = coding.unpack_codes(coding.pack_codes(codes, width), *codes.shape, width)
    assert np.array_equal(found.astype(np.int64), codes)


@given(hnp.arrays(np.float64, (12, 3), elements=st.floats(-1e6, 1e6, width=32)), st.integers(2, 12))
def test_rounding_twice_is_rounding_once(values: np.ndarray, bits: int) -> None:
    exponents = coding.spread_exponents(values, 1 << bits)
    once = coding.round_to_lattice(values, exponents)
    twice = coding.round_to_lattice(once, coding.spread_exponents(once, 1 << bits))
    assert np.array_equal(once, twice)
    step = np.ldexp(1.0, coding.exponents_of(once))
    assert np.array_equal(np.round(once / step) * step, once)
    assert (np.abs(once - values) <= np.ldexp(1.0, exponents) / 2).all()


@given(
    st.sets(st.tuples(*[st.integers(0, 70)] * 3), min_size=1, max_size=60),
    st.integers(7, 21),
    st.sampled_from([0, 1, 2, 4]),
)
def test_an_octree_gives_back_the_voxels(cells: set[Any], levels: int, bits: int) -> None:
    wanted = np.array(sorted(cells), np.int32)
    codes = _native.octree_encode(np.ascontiguousarray(wanted[::-1]), levels)
    assert np.array_equal(codes, _octree(wanted, levels))
    rng = np.random.default_rng(len(cells))
    parts = rng.integers(0, 1 << bits, wanted.shape)
    each = ((parts.reshape(-1, 1) >> np.arange(bits)) & 1).astype(np.uint8)
    packed_parts = np.packbits(each.reshape(-1), bitorder="little")
    low = np.array([-9, 2**40, 0])
    found = _native.octree_points(codes, levels, len(wanted), packed_parts, bits, low, ORIGIN, 0.3)
    expected = coding.lattice_points(wanted + low, parts, ORIGIN, 0.3, bits)
    assert np.array_equal(found, expected)
    for broken, count in [(codes[:-1], len(wanted)), (codes, len(wanted) + 1)]:
        parts_of = np.zeros((3 * count * bits + 7) // 8, np.uint8)
        with pytest.raises(ValueError, match="octree"):
            _native.octree_points(broken, levels, count, parts_of, bits, low, ORIGIN, 0.3)


def _octree(cells: np.ndarray, levels: int) -> np.ndarray:
    """Level by level, as docs/reference/formats.md has it."""
    rows = []
    for level in range(levels):
        nodes: dict[tuple[int, ...], int] = {}
        for cell in cells.tolist():
            node = tuple(c >> (levels - level) for c in cell)
            x, y, z = (c >> (levels - level - 1) & 1 for c in cell)
            nodes[node] = nodes.get(node, 0) | 1 << (4 * x + 2 * y + z)
        rows += [nodes[node] for node in sorted(nodes)]
    return np.array(rows, np.uint8)


# --- compact maps ---------------------------------------------------------------------------------


@pytest.mark.parametrize("quality", [False, True])
@pytest.mark.parametrize(
    "config",
    [CompactConfig(), MappingConfig().smallest().compact, CompactConfig(bits=12, max_views=0)],
)
def test_compact_maps_are_small_and_come_back(
    tmp_path: Path, config: CompactConfig, quality: bool
) -> None:
    made = town(quality=quality)
    small = compacted(made, config)
    assert_identical(small, compacted(small, config))
    made.save(tmp_path / "plain.segmap")
    small.save(tmp_path / "a.segmap")
    loaded = SegmentMap.load(tmp_path / "a.segmap")
    assert_identical(small, loaded)
    assert_identical(small, pickle.loads(pickle.dumps(loaded)))
    assert loaded.memory_bytes < 0.6 * small.memory_bytes
    loaded.save(tmp_path / "b.segmap")
    assert (tmp_path / "a.segmap").read_bytes() == (tmp_path / "b.segmap").read_bytes()
    sizes = [(tmp_path / f"{name}.segmap").stat().st_size for name in ("a", "plain")]
    assert sizes[0] < 0.35 * sizes[1]


def test_what_is_rounded_stays_near() -> None:
    made, config = town(), CompactConfig(max_views=0)
    small = compacted(made, config)
    _, rows = cKDTree(made.centroids).query(small.centroids)
    assert len(np.unique(rows)) == len(made) == len(small)
    assert np.abs(small.centroids - made.centroids[rows]).max() <= 1 / 128
    error = np.abs(small.vectors - made.vectors[rows]).max(axis=0)
    assert (error <= 3 * made.vectors.std(axis=0) / 2**config.bits).all()
    assert np.abs(small.cloud - made.cloud).max() <= made.cloud_voxel / 4 + 1e-4
    share = small.sizes / made.sizes[rows]
    assert (share <= 1).all() and (share > 3 / 4).all()
    for column in ("session", "stamps"):
        assert np.array_equal(getattr(small, column), getattr(made, column)[rows])


def test_merging_compact_maps_keeps_what_is_the_same_once() -> None:
    whole = compacted(town(), CompactConfig())
    left, right = (whole.crop(ORIGIN[:2] + [x, 0.0], 50.0) for x in (-30.0, 30.0))
    merged = left.merge(right)
    assert len(merged) == len(np.unique(np.r_[_rows(left), _rows(right)], axis=0))
    assert_identical(compacted(left.merge(left), CompactConfig()), compacted(left, CompactConfig()))


def _rows(prior_map: SegmentMap) -> np.ndarray:
    return np.column_stack([prior_map.centroids, prior_map.stamps, prior_map.vectors])


def test_merged_maps_of_other_origins_are_packed_again(tmp_path: Path) -> None:
    a, b = (
        compacted(town(seed=seed, origin=(4e5 + seed / 3, 5e6, 300.0)), CompactConfig())
        for seed in (0, 1)
    )
    merged = compacted(a.merge(b), CompactConfig())
    assert len(merged) == len(a) + len(b)
    merged.save(tmp_path / "a.segmap")
    assert b'"segmap_version":"2"' in (tmp_path / "a.segmap").read_bytes()


# --- files that are damaged or forged -------------------------------------------------------------


def _recipe(name: str, **values: Any) -> Callable[[dict[str, Any]], None]:
    def change(header: dict[str, Any]) -> None:
        recipes = json.loads(header["__metadata__"]["coding"])
        recipes[name].update(values)
        header["__metadata__"]["coding"] = json.dumps(recipes)

    return change


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda h: h["__metadata__"].pop("coding"), "unreadable coding"),
        (lambda h: h["__metadata__"].update(coding="{}"), "must be packed"),
        (lambda h: h["__metadata__"].update(coding="[" * 99_999), "unreadable coding"),
        (lambda h: h["__metadata__"].update(segmap_version="1"), "is U8"),
        (_recipe("cloud", shape=[2**40, 3]), "cannot unpack"),
        (_recipe("vectors", shape=[2**40, 7]), "cannot unpack"),
        (_recipe("vectors", shape=[(1 << 26) // 7, 7]), "cannot unpack"),
        (_recipe("vectors", shape=[-1, 7]), "unreadable coding"),
        (_recipe("vectors", shape=[1, 7]), r"is F32 \(1, 7\), not F32|are? .*\(1,"),
        (_recipe("vectors", width=3), "unreadable coding"),
        (_recipe("vectors", width=2), "vectors: does not inflate"),
        (_recipe("vectors", low=[0]), "coded with another width"),
        (_recipe("vectors", exponents=[150] * 7), "vectors: row"),
        (_recipe("sizes", low=[2**40]), "sizes: numbers out of range"),
        (_recipe("sizes", exponents=[40]), "sizes: numbers out of range"),
        (_recipe("stamps", values=1), "stamps"),
        (_recipe("stamps", values=2**39), "stamps: cut off"),
        (_recipe("cloud", levels=22), "unreadable coding"),
        (_recipe("cloud", levels=3), "cloud: the octree"),
        (_recipe("cloud", nodes=3), "cloud"),
        (_recipe("cloud", nodes=2**39), "cloud"),
        (_recipe("cloud", bits=0), "cloud"),
        (_recipe("cloud", low=[2**49, 0, 0]), "cloud: row 0"),
        (_recipe("centroids", low=[2**51, 0, 0]), "centroids: row 0"),
        (_recipe("trajectory", low=[0] * 16), "trajectory"),
        (_recipe("cloud", kind="pickle"), "unreadable coding"),
    ],
)
def test_forged_recipes_are_refused(
    tmp_path: Path,
    packed: tuple[SegmentMap, bytes],
    change: Callable[[dict[str, Any]], None],
    fault: str,
) -> None:
    assert_refused(tmp_path / "a.segmap", with_header(packed[1], change, sign=True), fault)


def test_a_bomb_inflates_to_no_more_than_it_may() -> None:
    """Zeros that would inflate to a thousand times their size."""
    bomb = zlib.compress(bytes(1 << 26), 9)
    assert len(bomb) < (1 << 26) // MAX_GROWTH
    with pytest.raises(coding.CodingError, match="does not inflate to 1000 bytes"):
        coding.inflate(bomb, 1000)


def test_what_lies_on_no_lattice_is_kept_as_it_is(tmp_path: Path) -> None:
    made = town()
    made.save(tmp_path / "a.segmap")
    header = (tmp_path / "a.segmap").read_bytes()[8:]
    assert b'"segmap_version":"1"' in header and b'"coding"' not in header
    assert_identical(made, SegmentMap.load(tmp_path / "a.segmap"))
    assert compacted(made, CompactConfig(enabled=False)) is made
