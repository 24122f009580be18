"""Exact nearest descriptors against brute force in double."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from segloc import SegmentMap, _native
from segloc.proposals.matching import Matcher, MatchingConfig
from segloc.types import Descriptors


def brute_force(queries: np.ndarray, database: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    difference = queries[:, None].astype(np.float64) - database[None].astype(np.float64)
    squared = np.cumsum(difference**2, axis=-1)[..., -1]  # summed in order
    order = np.argsort(squared, axis=1, kind="stable")[:, :k]
    return order, np.sqrt(np.take_along_axis(squared, order, axis=1))


def check(queries: np.ndarray, database: np.ndarray, k: int, isa: str = "auto") -> None:
    indices, distances = _native.knn(queries, database, k, 1, isa)
    order, expected = brute_force(queries, database, k)
    np.testing.assert_array_equal(indices, order)
    np.testing.assert_allclose(distances, expected, rtol=1e-6, atol=1e-30)


@pytest.mark.parametrize("isa", ["portable", "auto"])
@pytest.mark.parametrize(
    ("Q", "M", "D", "k"), [(37, 3000, 16, 25), (5, 900, 7, 200), (3, 2100, 64, 1), (17, 50, 80, 49)]
)
def test_matches_brute_force(isa: str, Q: int, M: int, D: int, k: int) -> None:
    rng = np.random.default_rng(Q)
    queries = rng.normal(size=(Q, D)).astype(np.float32)
    check(queries, rng.normal(size=(M, D)).astype(np.float32), k, isa)


@settings(max_examples=30)
@given(
    st.integers(1, 9), st.integers(1, 400), st.integers(1, 6), st.integers(1, 60), st.integers(0)
)
def test_ties_go_to_the_lower_index(Q: int, M: int, D: int, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    queries = rng.integers(-1, 2, (Q, D)).astype(np.float32)
    check(queries, rng.integers(-1, 2, (M, D)).astype(np.float32), k)


def test_far_from_the_origin() -> None:
    """Squares of differences, not differences of squares: no cancellation."""
    rng = np.random.default_rng(0)
    database = (1e4 + rng.normal(size=(2000, 16))).astype(np.float32)
    check(database[:20] + np.float32(0.01), database, 30)


@pytest.mark.parametrize("isa", ["portable", "auto"])
@pytest.mark.parametrize("dim", [3, 32])
def test_blocks_that_are_skipped_hold_no_neighbour(isa: str, dim: int) -> None:
    """Clusters, copies, an offset and values that dwarf all others, in a database with boxes."""
    rng = np.random.default_rng(dim)
    centres = 30 + 3 * rng.normal(size=(40, dim))
    database = centres[rng.integers(0, 40, 6000)] + rng.normal(size=(6000, dim))
    database[1000:1100] = database[0]
    database[7] *= 1e5
    queries = np.vstack([database[:60], centres[:4], np.zeros((1, dim))]).astype(np.float32)
    for k in (1, 25, 150):
        check(queries, database.astype(np.float32), k, isa)


def test_an_index_that_reads_every_list_is_exact() -> None:
    rng = np.random.default_rng(3)
    database = rng.normal(size=(5000, 12)).astype(np.float32)
    queries = rng.normal(size=(60, 12)).astype(np.float32)
    index = _native.DescriptorIndex(database, 40, 2)
    assert (len(index), index.lists) == (5000, 40)
    for threads in (1, 3):
        indices, distances = index.search(queries, 25, 40, threads)
        expected = _native.knn(queries, database, 25, 1)
        np.testing.assert_array_equal(indices, expected[0])
        np.testing.assert_array_equal(distances, expected[1])


@pytest.mark.parametrize("isa", ["portable", "auto"])
@pytest.mark.parametrize(("rows", "lists"), [(70, 1), (5000, 1), (5000, 40)])
def test_integers_of_a_lattice_are_found_like_their_numbers(
    isa: str, rows: int, lists: int
) -> None:
    rng = np.random.default_rng(5)
    codes = rng.integers(0, 256, (rows, 12), np.uint8)
    step = np.ldexp(1.0, rng.integers(-9, -5, 12)).astype(np.float32)
    base = rng.integers(-200, 10, 12).astype(np.float32) * step
    database = base + codes * step
    queries = database[:60] + rng.normal(0, 0.1, (60, 12)).astype(np.float32)
    numbers = _native.DescriptorIndex(database, lists, 1, isa)
    integers = _native.DescriptorIndex(codes, base, step, lists, 1, isa)
    for found, expected in zip(
        integers.search(queries, 25, 6), numbers.search(queries, 25, 6), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


def test_few_lists_hold_most_neighbours_and_always_enough() -> None:
    rng = np.random.default_rng(4)
    centres = rng.normal(size=(200, 16)) * 2
    database = (centres[rng.integers(0, 200, 20_000)] + rng.normal(size=(20_000, 16))).astype(
        np.float32
    )
    queries = (database[:100] + rng.normal(0, 0.1, (100, 16))).astype(np.float32)
    index = _native.DescriptorIndex(database, 100)
    exact = _native.knn(queries, database, 25)[0]
    found = index.search(queries, 25, 12)[0]
    shared = [len(np.intersect1d(a, b)) for a, b in zip(found, exact, strict=True)]
    assert np.mean(shared) > 0.95 * 25
    np.testing.assert_array_equal(index.search(queries, 25, 12, 2)[0], found)
    everything = index.search(queries[:2], 20_000, 1)[0]
    np.testing.assert_array_equal(np.sort(everything, axis=1), np.tile(np.arange(20_000), (2, 1)))


@settings(max_examples=30)
@given(st.integers(0, 300), st.integers(1, 5), st.integers(0))
def test_matches_come_by_score_then_query_then_segment(n: int, levels: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    query, prior_map = rng.integers(0, 6, n), rng.integers(0, 2**40, n)
    score = rng.choice([0.0, -0.0, -1.5, 1e-30, 0.7, np.float32(0.7) * 1.0000001], n)
    score = np.where(rng.random(n) < 0.5, score, rng.integers(0, levels, n)).astype(np.float32)
    order = _native.order_matches(query, prior_map, score)
    np.testing.assert_array_equal(order, np.lexsort((prior_map, query, -score)))


def test_queries_of_few_segments_get_more_neighbours() -> None:
    rng = np.random.default_rng(5)
    prior_map = SegmentMap.empty("geo", "geo", 7)
    prior_map.add(
        Descriptors(rng.normal(size=(3000, 7)).astype(np.float32)),
        rng.normal(size=(3000, 3)),
        np.full(3000, 50),
        session=0,
        stamp=0.0,
        cloud=np.empty((0, 3)),
    )
    query = Descriptors(rng.normal(size=(40, 7)).astype(np.float32))
    for indexed_from in (1000, 10_000):  # with an index and without
        found = []
        for matches in (100, 2400, 10_000):
            config = MatchingConfig(
                indexed_from=indexed_from, list_size=100, probes=6, matches=matches
            )
            found.append(Matcher(prior_map, config, threads=1).match(query))
        assert [len(each) for each in found] == [40 * 25, 2400, 40 * 100]
        few, _, many = found
        for row in range(40):
            nearest = many.map[many.query == row][:25]
            np.testing.assert_array_equal(nearest, few.map[few.query == row])
