"""What maps over recordings gives the same bytes, whoever does it and whoever is killed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.executors import EXECUTORS, Moved, Walk, square
from samples.plaza import Plaza
from segloc_lab.training.collect import Posed, collect_recordings
from segloc_lab.training.extract import ExtractConfig
from segloc_lab.training.shards import Session, finish

from segloc import Config
from segloc.errors import ConfigError, SeglocError
from segloc.frontend.segmentation import SegmentationConfig
from segloc.loops import AlignConfig, Alignment, align_sessions
from segloc.loops.summary import loops_jsonl
from segloc.map.build import build_merged_map
from segloc.system.processes import all_of, as_finished

GEO = Config.preset("geo").model_copy(update={"threads": 1})
ELSEWHERE = ("processes", "dask")
"""Those that pickle what they do, and lose a worker."""


@pytest.fixture(scope="module")
def walks(plaza: Plaza) -> list[Walk]:
    return [Walk(plaza, lane) for lane in (0.0, 1.0, 2.0)]


@pytest.mark.slow
@pytest.mark.parametrize("by", EXECUTORS)
def test_tasks_come_in_their_order_and_survive_a_killed_worker(by: str) -> None:
    with EXECUTORS[by]() as (executor, kill):
        assert all_of(square, range(12), executor, kill) == [n * n for n in range(12)]


def test_without_an_executor_this_process_does_it() -> None:
    seen: list[tuple[int, int]] = []
    assert all_of(square, [3, 4], None, lambda *at: seen.append(at)) == [9, 16]
    assert seen == [(1, 2), (2, 2)]
    assert list(as_finished(square, [], None)) == []


@pytest.fixture(scope="module")
def made_here(walks: list[Walk], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    file = tmp_path_factory.mktemp("made") / "here.segmap"
    build_merged_map(walks, GEO).save(file)
    return file.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("by", ELSEWHERE)
def test_a_map_of_many_recordings(
    by: str, walks: list[Walk], made_here: bytes, tmp_path: Path
) -> None:
    with EXECUTORS[by]() as (executor, kill):
        made = build_merged_map(walks, GEO, kill, executor=executor, folder=tmp_path)
    made.save(tmp_path / "there.segmap")
    assert made_here == (tmp_path / "there.segmap").read_bytes()
    assert len(np.unique(made.session)) == len(walks)
    assert [p.name for p in tmp_path.iterdir()] == ["there.segmap"]


def test_what_parts_cannot_be_written_to_is_said(walks: list[Walk], tmp_path: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as executor, pytest.raises(SeglocError, match="no such folder"):
        build_merged_map(walks[:1], GEO, executor=executor, folder=tmp_path / "lost")
    with pytest.raises(ConfigError, match="no session"):
        build_merged_map([], GEO)


ALIGN = AlignConfig(every_m=3.0, searched_parts=2)


@pytest.fixture(scope="module")
def moved(plaza: Plaza) -> list[Moved]:
    return [Moved(plaza, lane, 6) for lane in (0.0, 2.0)]


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
    assert here.components == there.components == [[0, 1]]
    for a, b in zip(here.poses, there.poses, strict=True):
        np.testing.assert_array_equal(a, b)
    assert loops_jsonl(here) == loops_jsonl(there)
    assert not list(tmp_path.iterdir())


@dataclass
class Collected:
    """Datasets of the walks, and the files of one that this process collected."""

    walks: list[Walk]
    register: bool
    here: dict[str, bytes]

    def made(self, folder: Path, executor: Any, say: Any) -> dict[str, bytes]:
        sessions = [Session("plaza", f"{k:02d}", "none") for k in range(len(self.walks))]
        settings = ExtractConfig(lengths_m=(8.0, 0.0), every_m=4.0)
        done = collect_recordings(
            folder,
            [Posed(session, walk) for session, walk in zip(sessions, self.walks, strict=True)],
            settings,
            SegmentationConfig(),
            register=self.register,
            progress=say,
            executor=executor,
        )
        finish(folder, done, settings.label)
        return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def collected(
    request: pytest.FixtureRequest, walks: list[Walk], tmp_path_factory: pytest.TempPathFactory
) -> Collected:
    found = Collected(walks, request.param, {})
    found.here = found.made(tmp_path_factory.mktemp("collected") / "here", None, print)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("collected", "by"), [(False, "processes"), (True, "dask")], indirect=["collected"]
)
def test_a_dataset_to_train_on(
    by: str, walks: list[Walk], collected: Collected, tmp_path: Path
) -> None:
    made, here = collected.made, collected.here
    with EXECUTORS[by]() as (executor, kill):
        assert made(tmp_path / "there", executor, lambda _: kill(1, 4)) == here
        said: list[str] = []
        assert made(tmp_path / "there", executor, said.append) == here
    assert all(text.endswith("already there") for text in said) and len(said) == len(walks)
