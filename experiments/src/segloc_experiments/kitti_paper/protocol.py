"""Methods through the protocol: K and a threshold at training places, then the test.

Answers are kept as JSON, a file a method: only methods that miss are measured. A run that was cut
off goes on at the query where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from segloc import Localizer, SegmentMap
from segloc.batch.methods import fingerprint
from segloc.descriptors import create
from segloc.files import write_text

from ..results.fingerprints import fingerprints
from .answers import ESTIMATORS, NEIGHBOURS, Asked, Place, configs, maps, queries, verified
from .counting import chosen
from .places import Part, test_part, training_part

Row = dict[str, Any]
Wanted = Mapping[str, tuple[int, ...]]


def answers_of(
    methods: Sequence[str],
    data: Path,
    folder: Path,
    say: Callable[[str], object] = print,
    verify: bool = True,
) -> dict[str, dict[str, Any]]:
    """What methods answer to every query, from the folder where it is there and of this code.

    Without ``verify`` by inliers alone, which takes a third of the time.
    """
    stages = fingerprints()
    produced = {
        name: {"method": fingerprint(name), "stages": stages, "verified": verify}
        for name in methods
    }
    found = {name: _stored(folder / f"{name}.json", produced[name]) for name in methods}
    missing = tuple(name for name in methods if not found[name])
    if missing:
        key = hashlib.sha256(json.dumps([produced[name] for name in missing]).encode())
        work = folder / f"unfinished-{key.hexdigest()[:12]}"
        for name, measured in Run(missing, data, work, say, verify).answers().items():
            found[name] = {**produced[name], **measured}
            write_text(folder / f"{name}.json", json.dumps(found[name], indent=0) + "\n")
        shutil.rmtree(work)
    return found


def _stored(path: Path, produced: Mapping[str, Any]) -> dict[str, Any]:
    if not path.exists():
        return {}
    stored: dict[str, Any] = json.loads(path.read_text("utf-8"))
    same = all(stored.get(key) == value for key, value in produced.items())
    return stored if same else {}


class Run:
    """Methods that are measured together: each cloud is gathered and segmented once for all.

    Parameters
    ----------
    methods : sequence of str
    data, folder : Path
        KITTI 00, and where maps and answers are kept until all is done.
    say : callable
        Takes remarks of one line.
    verify : bool
        Whether to ask the variants with verification, too.
    """

    def __init__(
        self,
        methods: Sequence[str],
        data: Path,
        folder: Path,
        say: Callable[[str], object],
        verify: bool,
    ) -> None:
        self._verify = verify
        self._descriptors = {name: create(name, 1) for name in methods}
        self._data, self._folder, self._say = data, folder, say

    def answers(self) -> dict[str, dict[str, Any]]:
        """Choose the Ks at training places, then localize the test's queries with them."""
        every: dict[str, Wanted] = {
            name: dict.fromkeys(ESTIMATORS, NEIGHBOURS) for name in self._descriptors
        }
        trained = self._rows("training", training_part(self._data), every)
        ks = {
            name: {each: chosen(rows, each, NEIGHBOURS) for each in ESTIMATORS}
            for name, rows in trained.items()
        }
        one: dict[str, Wanted] = {
            name: {each: (k,) for each, k in found.items()} for name, found in ks.items()
        }
        verifying = ks if self._verify else None
        answered = self._rows("test", test_part(self._data), one, verifying)
        return {
            name: {"neighbours": ks[name], "training": trained[name], "test": answered[name]}
            for name in self._descriptors
        }

    def _rows(
        self,
        label: str,
        part: Part,
        wanted: Mapping[str, Wanted],
        verifying: Mapping[str, Mapping[str, int]] | None = None,
    ) -> dict[str, list[Row]]:
        """The answers of every method to every query; verified ones where Ks for them are given."""
        paths = {name: self._folder / f"{label}-{name}.jsonl" for name in self._descriptors}
        done = min(len(_lines(path)) for path in paths.values())
        if done < len(part.positions):
            self._say(f"{label}: mapping")
            places = _places(maps(part.mapped, self._descriptors, self._folder / label))
            self._say(f"{label}: queries from {done} on")
            kept = {name: _lines(path)[:done] for name, path in paths.items()}
            for name, path in paths.items():
                path.write_text("".join(kept[name]), "utf-8")
            for asked in queries(part, self._descriptors, done):
                for name, place in places.items():
                    ks = verifying[name] if verifying else None
                    row = json.dumps(_row(place, name, asked, wanted[name], ks))
                    with paths[name].open("a", encoding="utf-8") as file:
                        file.write(row + "\n")
        return {name: [json.loads(line) for line in _lines(path)] for name, path in paths.items()}


def _row(
    place: Place, name: str, asked: Asked, wanted: Wanted, ks: Mapping[str, int] | None
) -> Row:
    query, truth = asked.described[name], asked.truth
    row = {**asked.row, **place.unverified(query, truth, wanted)}
    for variant, config in configs(name, ks).items() if ks else ():
        row[variant] = verified(place.with_config(config), query, truth)
    return row


def _lines(path: Path) -> list[str]:
    """The lines of a file that were written to their ends."""
    lines = path.read_text("utf-8").splitlines(keepends=True) if path.exists() else []
    return [line for line in lines if line.endswith("\n")]


def _places(built: Mapping[str, SegmentMap]) -> dict[str, Place]:
    places: dict[str, Place] = {}
    first: Localizer | None = None
    for name, prior_map in built.items():
        places[name] = Place(prior_map, name, first)
        first = first or places[name].base
    return places
