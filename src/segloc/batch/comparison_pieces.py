"""The queries of a scenario in pieces: each is answered in a process of its own, and kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..processes import in_parallel
from ..types import Float64
from . import comparison
from .cache import load_arrays, load_json, save_arrays, save_json
from .comparison import query_arrays
from .scenario import QuerySet, Scenario
from .workspace import Workspace

PIECE = 50
"""So many queries of a scenario are answered, and kept, at once."""

Key = tuple[str, dict[str, Any]]
"""Name and settings by which a piece is kept."""


@dataclass(frozen=True)
class Job:
    """Some queries of a scenario, to be answered by some methods, in a process of its own.

    Attributes
    ----------
    piece : int
        Of :data:`PIECE` queries each: which of them.
    """

    scenario: Scenario
    methods: tuple[str, ...]
    threads: int
    piece: int = 0


@dataclass(frozen=True)
class Piece:
    """What a job found.

    Attributes
    ----------
    answers, arrays : dict
        As :func:`~segloc.batch.comparison.localize_all` returns them; the arrays are those of the
        whole scenario.
    number : int
        How many pieces the scenario has.
    """

    answers: dict[str, Any]
    arrays: dict[str, Float64]
    number: int


def done(job: Job) -> tuple[Job, Piece]:
    """The job, and what was found."""
    opened = job.scenario.open()
    queries = sum(len(each.positions) for each in opened.query_sets.values())
    part = replace(opened, query_sets=_queries_of(opened.query_sets, job.piece))
    answers, arrays = comparison.localize_all(part, job.methods, job.threads)
    arrays |= query_arrays(opened.query_sets)
    return job, Piece(answers, arrays, max(1, -(-queries // PIECE)))


def _queries_of(query_sets: Mapping[str, QuerySet], piece: int) -> dict[str, QuerySet]:
    """The same sets, each with those of its queries alone that belong to a piece."""
    found, before = {}, 0
    for name, each in query_sets.items():
        first, last = (int(np.clip(k * PIECE - before, 0, None)) for k in (piece, piece + 1))
        truths = None if each.truths is None else each.truths[first:last]
        found[name] = replace(each, positions=each.positions[first:last], truths=truths)
        before += len(each.positions)
    return found


def pieces(
    workspace: Workspace, jobs: Sequence[Job], key: Callable[[Job], Key], title: str
) -> list[Piece]:
    """What the jobs find, in their order; what has been found before is not looked for again."""
    keys = [(name, {**settings, "queries": PIECE}) for name, settings in map(key, jobs)]
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
