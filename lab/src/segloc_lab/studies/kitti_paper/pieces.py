"""The protocol in pieces: some queries of one part, asked of one method in a process of its own.

A piece that was cut off goes on at the query where it stopped.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segloc.descriptors import create
from segloc.errors import SeglocError

from . import places
from .answers import Place, prior_map, queries

QUERIES = 34
"""Of one piece."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Piece:
    """Some of the queries of one part, asked of one method.

    Attributes
    ----------
    method, part : str
        The part is one of :data:`.places.PARTS`.
    first, stop : int
        Which queries of the part.
    data, folder : Path
        KITTI 00, and where the maps and answers of the method are kept.
    verify : bool
        Whether to ask the variants with verification, too; never at training places.
    draws : int
        Of PROSAC, at most.
    """

    method: str
    part: str
    first: int
    stop: int
    data: Path
    folder: Path
    verify: bool
    draws: int

    @property
    def rows(self) -> list[Row]:
        """The answers so far, of one query after the other."""
        return [json.loads(line) for line in _lines(self._path)]

    @property
    def is_done(self) -> bool:
        """Whether all queries are answered."""
        return len(_lines(self._path)) == self.stop - self.first

    @property
    def _path(self) -> Path:
        return self.folder / f"{self.part}-{self.first:03d}.jsonl"

    def run(self) -> Piece:
        """Answer what is not answered yet; makes the map if there is none."""
        kept = _lines(self._path)
        self._path.write_text("".join(kept), "utf-8")
        part = places.PARTS[self.part](self.data).between(self.first + len(kept), self.stop)
        built = prior_map(part.mapped, self.method, self.folder / f"{self.part}.segmap")
        place, verify = Place(built, self.method, self.draws), self.verify and self.part == "test"
        for asked in queries(part, create(self.method, 1)):
            row = {**asked.row, **place.unverified(asked.query, asked.truth)}
            if verify:
                row.update(place.verified(asked.query, asked.truth))
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        return self


def _lines(path: Path) -> list[str]:
    """The lines of a file that were written to their ends."""
    lines = path.read_text("utf-8").splitlines(keepends=True) if path.exists() else []
    return [line for line in lines if line.endswith("\n")]


def spans(count: int) -> Iterator[tuple[int, int]]:
    """The first of the queries of each piece, and the one behind its last."""
    for first in range(0, count, QUERIES):
        yield first, min(first + QUERIES, count)


def finished(pieces: Sequence[Piece], executor: Executor | None) -> Iterator[Piece]:
    """The pieces as they are finished; the first one of each map, which makes it, before others.

    Raises
    ------
    SeglocError
        If the system ended a process, as it does when memory runs out.
    """
    left = [piece for piece in pieces if not piece.is_done]
    yield from (piece for piece in pieces if piece.is_done)
    if executor is None:
        yield from map(Piece.run, left)
        return
    waiting: dict[tuple[str, str], list[Piece]] = {}
    for piece in left:
        waiting.setdefault((piece.method, piece.part), []).append(piece)
    try:
        running = {executor.submit(Piece.run, behind.pop(0)) for behind in waiting.values()}
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for piece in map(Future[Piece].result, done):
                yield piece
                behind = waiting.pop((piece.method, piece.part), [])
                running |= {executor.submit(Piece.run, each) for each in behind}
    except BrokenExecutor as error:
        raise SeglocError(
            "a worker process was ended, most likely because memory ran out: try fewer workers, "
            "such as --workers 1; what is finished is kept"
        ) from error
