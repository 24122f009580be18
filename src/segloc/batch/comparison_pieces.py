"""The queries of a scenario in pieces: each is answered in a process of its own, and kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..descriptors import Descriptor, create
from ..map.segment_map import SegmentMap
from ..processes import in_parallel
from ..types import Float64
from . import comparison
from .cache import DATA, load_arrays, load_json, save_arrays, save_json, store
from .comparison import MappedPlace, arrays_of, build_maps, place_of
from .scenario import OpenedScenario, QuerySet, Scenario
from .workspace import Workspace

PIECE, PIECES = 2, 16
"""So many queries of a scenario are answered, and kept, at once; more where it would be in more
pieces than so many."""


@dataclass(frozen=True)
class Job:
    """Some queries of a scenario, to be answered by some methods, in a process of its own.

    Attributes
    ----------
    maps : Path
        Where the maps are left for all pieces; the name of this folder, and so what a piece is
        kept by, is another one for all other settings.
    piece : int
        Which of them, from 1. Before them comes 0, which makes the maps and answers nothing: pieces
        are then about alike, and no process waits for another at the end.
    """

    scenario: Scenario
    methods: tuple[str, ...]
    threads: int
    maps: Path
    piece: int = 0


@dataclass(frozen=True)
class Piece:
    """What a job found.

    Attributes
    ----------
    answers : dict
        As :func:`~segloc.batch.comparison.localize_all` returns them; none of piece 0.
    arrays : dict
        Those of the whole scenario, see :func:`~segloc.batch.comparison.arrays_of`; of piece 0
        only.
    number : int
        How many pieces the scenario has, beside piece 0.
    """

    answers: dict[str, Any]
    arrays: dict[str, Float64]
    number: int


def done(job: Job) -> tuple[Job, Piece]:
    """The job, and what was found."""
    opened = job.scenario.open()
    descriptors = {name: create(name, job.threads) for name in job.methods}
    places = _places(opened, descriptors, job)
    queries = sum(len(each.positions) for each in opened.query_sets.values())
    size = max(PIECE, -(-queries // PIECES))
    number = max(1, -(-queries // size))
    if job.piece == 0:
        return job, Piece({}, arrays_of(opened.query_sets, places["map"]), number)
    part = _queries_of(opened.query_sets, (job.piece - 1) * size, size)
    return job, Piece(comparison.localize_all(part, descriptors, places), {}, number)


def _places(
    opened: OpenedScenario, descriptors: Mapping[str, Descriptor], job: Job
) -> dict[str, MappedPlace]:
    """The map, and the negative one, from where they are kept; made where they are not."""
    found = {}
    for name, recording in (("map", opened.map), ("negative", opened.negative)):
        if recording is None:
            continue
        if not (job.maps / name).exists():
            maps = build_maps(recording, descriptors, job.threads)
            store(job.maps / name, {}, partial(_save_maps, maps))
        files = {each: job.maps / name / DATA / f"{each}.segmap" for each in descriptors}
        maps = {each: SegmentMap.load(file) for each, file in files.items()}
        found[name] = place_of(maps, job.threads, job.scenario.segments_alone)
    return found


def _save_maps(maps: Mapping[str, SegmentMap], folder: Path) -> None:
    folder.mkdir()
    for name, prior_map in maps.items():
        prior_map.save(folder / f"{name}.segmap")


def _queries_of(query_sets: Mapping[str, QuerySet], start: int, size: int) -> dict[str, QuerySet]:
    """The same sets, with so many queries of them all together, the first ``start`` left out."""
    found, before = {}, 0
    for name, each in query_sets.items():
        first, last = (int(np.clip(k - before, 0, None)) for k in (start, start + size))
        truths = None if each.truths is None else each.truths[first:last]
        found[name] = replace(each, positions=each.positions[first:last], truths=truths)
        before += len(each.positions)
    return found


def pieces(workspace: Workspace, jobs: Sequence[Job], title: str) -> list[Piece]:
    """What the jobs find, in their order; what has been found before is not looked for again."""
    keys = [
        (
            f"piece-{job.scenario.name}-{job.piece}",
            {"maps": job.maps.name, "queries": [PIECE, PIECES]},
        )
        for job in jobs
    ]
    found = [workspace.find(*each, _load_piece) for each in keys]
    left = {k: job for k, job in enumerate(jobs) if found[k] is None}
    with workspace.progress(title) as update:
        update(0, len(left))
        finished = in_parallel(done, list(left.values()), workspace.workers, workspace.executor)
        for count, (job, piece) in enumerate(finished):
            k = next(k for k, other in left.items() if other == job)
            found[k] = piece
            workspace.keep(*keys[k], piece, _save_piece)
            update(count + 1, len(left))
    return [piece for piece in found if piece is not None]


def joined(parts: Sequence[Any]) -> Any:
    """Lists at the same place of nested dicts, one after another."""
    if isinstance(parts[0], dict):
        return {key: joined([part[key] for part in parts]) for key in parts[0]}
    return [each for part in parts for each in part]


def _save_piece(piece: Piece, path: Path) -> None:
    path.mkdir()
    save_json({"answers": piece.answers, "number": piece.number}, path / "answers.json")
    save_arrays(piece.arrays, path / "arrays.npz")


def _load_piece(path: Path) -> Piece:
    return Piece(**load_json(path / "answers.json"), arrays=load_arrays(path / "arrays.npz"))
