"""One limit for all inputs, moved by the environment; and nothing that grows with distances."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import io as samples

from segloc import geometry
from segloc.errors import ConfigError, DatasetError
from segloc.system import budget
from segloc.system.processes import ProcessPool
from segloc.tools.io import read_scan

CLOUD = samples.cloud(40)
FILES = samples.samples(CLOUD)


@pytest.mark.parametrize("name", sorted(FILES))
def test_every_format_keeps_to_the_limit(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name])
    monkeypatch.setenv(budget.OPTION, "39")
    with pytest.raises(DatasetError) as caught:
        read_scan(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and f"increase {budget.OPTION}" in message
    monkeypatch.setenv(budget.OPTION, "4000")
    assert len(read_scan(path)) == 40


def test_workers_keep_to_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(budget.OPTION, "39")
    with ProcessPool(1) as pool:
        assert pool.submit(budget.most_points).result() == 39


@pytest.mark.parametrize("text", ["-1", "0", "1e9", "9" * 99, "١"])
def test_a_limit_that_is_none(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(budget.OPTION, text)
    with pytest.raises(ConfigError, match=budget.OPTION):
        budget.most_points()


@settings(max_examples=20)
@given(st.lists(st.integers(0, 9), min_size=1, max_size=900), st.integers(1, 60))
def test_lists_of_any_lengths_before_the_vertices(lengths: list[int], same: int) -> None:
    """However many rows in a row are alike."""
    from segloc.tools.io.ply import parse_ply

    counts = [n for n in lengths for _ in range(same)]
    head = f"ply\nformat binary_big_endian 1.0\nelement face {len(counts)}\nproperty short a\n"
    head += "property list uchar short b\nproperty list ushort char c\nelement vertex 40\n"
    head += "property float x\nproperty float y\nproperty float z\nend_header\n"
    rows = b"".join(
        b"\1\2" + bytes([n]) + bytes(2 * n) + (9 - n).to_bytes(2, "big") + bytes(9 - n)
        for n in counts
    )
    scan = parse_ply(head.encode() + rows + CLOUD.astype(">f4").tobytes())
    np.testing.assert_array_equal(scan.points, CLOUD)


@given(
    st.lists(st.floats(0.0, 5.0), min_size=1, max_size=40),
    st.floats(0.05, 20.0),
    st.booleans(),
)
def test_stations_are_those_of_marks(steps: list[float], every: float, behind: bool) -> None:
    way = np.concatenate([[0.0], np.cumsum(steps)])
    first = every if behind else 0.0
    marks = np.arange(first, way[-1] + 1e-9, every)
    expected = np.unique(np.searchsorted(way, marks - 1e-9))
    np.testing.assert_array_equal(geometry.stations(way, every, first), expected)


@pytest.mark.parametrize("every", [5e-324, 1e-300, 1e-9, 1e300])
def test_stations_take_no_memory_for_marks(every: float) -> None:
    way = np.array([0.0, 0.0, 1.0, 1e12, 1e12, 2e15])
    tracemalloc.start()
    try:
        found = geometry.stations(way, every)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    assert found[0] == 0 and len(found) <= 4
