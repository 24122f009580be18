"""The queries of a scenario in pieces: each is answered in a process of its own, and kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from segloc.descriptors import Descriptor, create
from segloc.map.segment_map import SegmentMap
from segloc.system.processes import in_parallel
from segloc.types import Float64

from . import comparison
from .cache import DATA, load_arrays, load_json, save_arrays, save_json, store
from .comparison import MappedPlace, arrays_of, build_maps, place_of
from .scenario import OpenedScenario, QuerySet, Scenario
from .workspace import Workspace

PIECE, PIECES = 1, 32
"""So many queries of a scenario are answered, and kept, at once; more where it would be in more
pieces than so many."""

PLACES = ("map", "negative")
_ARRAYS = "arrays.npz"

Answers = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """The queries of a scenario, to be answered by some methods.

    Attributes
    ----------
    maps : Path
        Where the maps are left for all pieces; the name of this folder, and so what a piece is
        kept by, is another one for all other settings.
    """

    scenario: Scenario
    methods: tuple[str, ...]
    threads: int
    maps: Path

    def arrays(self) -> dict[str, Float64]:
        """Those of :func:`~segloc_lab.evaluation.comparison.arrays_of`, once the map is made."""
        return load_arrays(self.maps / "map" / DATA / _ARRAYS)

    def descriptors(self) -> dict[str, Descriptor]:
        return {name: create(name, self.threads) for name in self.methods}


@dataclass(frozen=True)
class Piece:
    """The queries of a job from ``start`` on, so many of them; ``number`` tells pieces apart."""

    job: Job
    number: int
    start: int
    size: int


@dataclass(frozen=True)
class Prepared:
    """A scenario that is ready to be answered."""

    query_sets: Mapping[str, QuerySet]
    descriptors: Mapping[str, Descriptor]
    places: Mapping[str, MappedPlace]


def make_maps(workspace: Workspace, jobs: Sequence[Job]) -> None:
    """The maps of all jobs, each in a process of its own, where they are not yet."""
    left = [(job, name) for job in jobs for name in PLACES if not (job.maps / name).exists()]
    with workspace.progress("Building maps") as update:
        update(0, len(left))
        made = in_parallel(_make_map, left, workspace.workers, workspace.executor)
        for count, _ in enumerate(made, 1):
            update(count, len(left))


def _make_map(task: tuple[Job, str]) -> None:
    job, name = task
    opened = job.scenario.open()
    recording = opened.map if name == "map" else opened.negative
    if recording is None:
        return
    maps = build_maps(recording, job.descriptors(), job.threads)
    first = next(iter(maps.values()))
    arrays = arrays_of(opened.query_sets, first.trajectory, first.cloud + first.origin)
    store(job.maps / name, {}, partial(_save, maps, arrays))


def _save(maps: Mapping[str, SegmentMap], arrays: Mapping[str, Float64], folder: Path) -> None:
    folder.mkdir()
    for name, prior_map in maps.items():
        prior_map.save(folder / f"{name}.segmap")
    save_arrays(arrays, folder / _ARRAYS)


def answers_of(workspace: Workspace, jobs: Sequence[Job]) -> list[Answers]:
    """Localize each job by :func:`.comparison.localize_all`; in the order of the jobs.

    Pieces that have been answered before are not answered again.
    """
    pieces = [piece for job in jobs for piece in _pieces(job)]
    keys = [_key(piece) for piece in pieces]
    try:
        found = workspace.cached_each("Localizing", keys, _answer, pieces, save_json, load_json)
    finally:
        _prepared.clear()
    whole: dict[Path, list[Answers]] = {job.maps: [] for job in jobs}
    for piece, answers in zip(pieces, found, strict=True):
        whole[piece.job.maps].append(answers)
    return [_joined(parts) for parts in whole.values()]


def _pieces(job: Job) -> list[Piece]:
    arrays = job.arrays()
    queries = sum(len(each) for name, each in arrays.items() if name.startswith("indices-"))
    size = max(PIECE, -(-queries // PIECES))
    starts = range(0, max(queries, 1), size)
    return [Piece(job, number, start, size) for number, start in enumerate(starts, 1)]


def _key(piece: Piece) -> tuple[str, dict[str, Any]]:
    settings = {"maps": piece.job.maps.name, "queries": [piece.start, piece.size]}
    return f"piece-{piece.job.scenario.name}-{piece.number}", settings


def _answer(piece: Piece) -> Answers:
    ready = _ready(piece.job)
    part = _queries_of(ready.query_sets, piece.start, piece.size)
    return comparison.localize_all(part, ready.descriptors, ready.places)


_prepared: dict[Path, Prepared] = {}
"""What this process answers, by its maps: pieces of one scenario come one after another, and it is
made ready once. It is large, so never two of them."""


def _ready(job: Job) -> Prepared:
    ready = _prepared.get(job.maps)
    if ready is None:
        _prepared.clear()
        opened = job.scenario.open()
        ready = Prepared(opened.query_sets, job.descriptors(), _places(opened, job))
        _prepared[job.maps] = ready
    return ready


def _places(opened: OpenedScenario, job: Job) -> dict[str, MappedPlace]:
    found = {}
    for name, recording in zip(PLACES, (opened.map, opened.negative), strict=True):
        if recording is None:
            continue
        files = {each: job.maps / name / DATA / f"{each}.segmap" for each in job.methods}
        maps = {each: SegmentMap.load(file) for each, file in files.items()}
        found[name] = place_of(maps, job.threads, job.scenario.segments_alone)
    return found


def _queries_of(query_sets: Mapping[str, QuerySet], start: int, size: int) -> dict[str, QuerySet]:
    """The same sets, with so many queries of them all together, the first ``start`` left out."""
    found, before = {}, 0
    for name, each in query_sets.items():
        first, last = (int(np.clip(k - before, 0, None)) for k in (start, start + size))
        truths = None if each.truths is None else each.truths[first:last]
        found[name] = replace(each, positions=each.positions[first:last], truths=truths)
        before += len(each.positions)
    return found


def _joined(parts: Sequence[Any]) -> Any:
    """Lists at the same place of nested dicts, one after another."""
    if isinstance(parts[0], dict):
        return {key: _joined([part[key] for part in parts]) for key in parts[0]}
    return [each for part in parts for each in part]
