"""Methods through the protocol: answers with every K, of which one is chosen at training places.

Answers are kept as JSON, a file a method: only methods that miss are measured.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segloc.errors import DatasetError
from segloc.system.files import write_text
from segloc.system.processes import executing

from ...evaluation.methods import METHODS, fingerprint
from ...report import code, commit
from . import places
from .answers import DRAWS, ESTIMATORS, NEIGHBOURS
from .counting import chosen
from .pieces import Piece, Row, finished, spans

Answers = dict[str, Any]


@dataclass(frozen=True)
class Kept:
    """Where the answers of one method are kept, and of which code and weights they are.

    Attributes
    ----------
    method : str
    folder : Path
        Of all methods.
    produced : dict
        What the answers depend on: those of other code are not used.
    """

    method: str
    folder: Path
    produced: Mapping[str, Any]

    @classmethod
    def of(cls, method: str, folder: Path, verify: bool, draws: int) -> Kept:
        """By the code as it is now."""
        produced: Answers = {
            "method": fingerprint(method),
            "code": code(),
            "verified": verify,
        }
        if draws != DRAWS:
            produced["draws"] = draws
        return cls(method, folder, produced)

    def read(self) -> Answers | None:
        """The answers, if they are there and of this code."""
        if not self._path.exists():
            return None
        stored: Answers = json.loads(self._path.read_text("utf-8"))
        draws = stored.get("draws") == self.produced.get("draws")
        same = draws and all(stored.get(key) == value for key, value in self.produced.items())
        return stored if same else None

    def pieces(self, data: Path, counts: Mapping[str, int]) -> list[Piece]:
        """All pieces of the method; ``counts`` are the queries of each part."""
        self._work.mkdir(parents=True, exist_ok=True)
        asked = (bool(self.produced["verified"]), self.produced.get("draws", DRAWS))
        return [
            Piece(self.method, part, first, stop, data, self._work, *asked)
            for part, count in counts.items()
            for first, stop in spans(count)
        ]

    def finish(self, pieces: Iterable[Piece]) -> None:
        """Put the answers of all pieces together, and choose the Ks."""
        parts: dict[str, list[Row]] = {}
        for piece in pieces:
            parts.setdefault(piece.part, []).extend(piece.rows)
        neighbours = {each: chosen(parts["training"], each, NEIGHBOURS) for each in ESTIMATORS}
        answers = {**self.produced, "commit": commit(), "neighbours": neighbours, **parts}
        write_text(self._path, json.dumps(answers, indent=0) + "\n")
        shutil.rmtree(self._work)

    @property
    def _path(self) -> Path:
        return self.folder / f"{self.method}.json"

    @property
    def _work(self) -> Path:
        key = hashlib.sha256(json.dumps(self.produced).encode()).hexdigest()
        return self.folder / f"unfinished-{self.method}-{key[:12]}"


def answers_of(
    methods: Sequence[str],
    data: Path,
    folder: Path,
    say: Callable[[str], object] = print,
    verify: bool = True,
    workers: int = 1,
    draws: int = DRAWS,
) -> dict[str, Answers]:
    """What methods answer to every query, from the folder where it is there and of this code.

    Without ``verify`` by inliers alone, which takes a third of the time.
    """
    kept = {name: Kept.of(name, folder, verify, draws) for name in methods}
    missing = [each for each in kept.values() if each.read() is None]
    if missing:
        _measure(missing, data, say, workers)
    return {name: each.read() or {} for name, each in kept.items()}


def _measure(
    missing: Sequence[Kept], data: Path, say: Callable[[str], object], workers: int
) -> None:
    counts = {name: len(part(data).positions) for name, part in places.PARTS.items()}
    pieces = {each.method: each.pieces(data, counts) for each in missing}
    kept = {each.method: each for each in missing}
    every = [piece for part in counts for own in pieces.values() for piece in own
             if piece.part == part]  # fmt: skip
    left = {name: len(own) for name, own in pieces.items()}
    with executing(workers, None) as executor:
        for number, piece in enumerate(finished(every, executor), 1):
            name = piece.method
            say(f"{number} of {len(every)}: {name}, {piece.part} from {piece.first} on")
            left[name] -= 1
            if not left[name]:
                kept[name].finish(pieces[name])


def stored(folder: Path) -> dict[str, Answers]:
    """The answers of all methods that a folder has, whatever code they are of.

    Raises
    ------
    DatasetError
        If there are none.
    """
    paths = {name: folder / f"{name}.json" for name in METHODS}
    found = {name: json.loads(p.read_text("utf-8")) for name, p in paths.items() if p.exists()}
    if not found:
        raise DatasetError(f"{folder}: no method is measured there to its end")
    return found
