"""What maps over recordings gives the same bytes, whoever does it and whoever is killed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.executors import EXECUTORS, Moved, Walk, square
from samples.plaza import Plaza

from segloc import Config
from segloc.errors import ConfigError, SeglocError
from segloc.loops import AlignConfig, Alignment, align_sessions
from segloc.map.build import build_merged_map
from segloc.system.processes import all_of
from segloc.tools.inspect.alignment import loops_jsonl

GEO = Config.preset("geo").model_copy(update={"threads": 1})


@pytest.fixture(scope="module")
def plaza() -> Plaza:
    return Plaza(0).thinned(3)


@pytest.fixture(scope="module")
def walks(plaza: Plaza) -> list[Walk]:
    return [Walk(plaza, lane) for lane in (0.0, 1.0, 2.0)]


@pytest.mark.slow
@pytest.mark.parametrize("by", ["threads", "processes"])
def test_tasks_come_in_their_order_and_survive_a_killed_worker(by: str) -> None:
    with EXECUTORS[by]() as (executor, kill):
        assert all_of(square, range(12), executor, kill) == [n * n for n in range(12)]


@pytest.fixture(scope="module")
def made_here(walks: list[Walk], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    file = tmp_path_factory.mktemp("made") / "here.segmap"
    build_merged_map(walks, GEO).save(file)
    return file.read_bytes()


@pytest.mark.slow
def test_a_map_of_many_recordings(walks: list[Walk], made_here: bytes, tmp_path: Path) -> None:
    with EXECUTORS["processes"]() as (executor, kill):
        made = build_merged_map(walks, GEO, kill, executor=executor, folder=tmp_path)
    made.save(tmp_path / "there.segmap")
    assert made_here == (tmp_path / "there.segmap").read_bytes()
    assert len(np.unique(made.session)) == len(walks)
    assert [p.name for p in tmp_path.iterdir()] == ["there.segmap"]


def test_what_parts_cannot_be_written_to_is_said(walks: list[Walk], tmp_path: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as executor, pytest.raises(SeglocError, match="no such folder"):
        build_merged_map(walks[:1], GEO, executor=executor, folder=tmp_path / "lost")
    with pytest.raises(ConfigError, match="no recordings"):
        build_merged_map([], GEO)


ALIGN = AlignConfig(every_m=3.0, searched_parts=2)


@pytest.fixture(scope="module")
def moved(plaza: Plaza) -> list[Moved]:
    return [Moved(plaza, lane, 8) for lane in (0.0, 1.0, 2.0)]


@pytest.fixture(scope="module")
def aligned_here(moved: list[Moved]) -> Alignment:
    return align_sessions(moved, GEO, ALIGN)


@pytest.mark.slow
def test_aligned_sessions(moved: list[Moved], aligned_here: Alignment, tmp_path: Path) -> None:
    here = aligned_here
    with EXECUTORS["dask"]() as (executor, kill):

        @contextmanager
        def stage(label: str) -> Iterator[Any]:
            yield kill

        there = align_sessions(moved, GEO, ALIGN, stage, executor=executor, folder=tmp_path)
    assert here.components == there.components == [[0, 1, 2]]
    for a, b in zip(here.poses, there.poses, strict=True):
        np.testing.assert_array_equal(a, b)
    assert loops_jsonl(here) == loops_jsonl(there)
    assert not list(tmp_path.iterdir())
