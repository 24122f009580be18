"""Methods through the protocol: K and a threshold at training places, then the test.

Answers are kept as JSON, a file a method: a run that was cut off goes on with those that miss.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from segloc import Localizer, SegmentMap
from segloc.batch.methods import fingerprint
from segloc.descriptors import Descriptor, create
from segloc.files import write_text

from ..results.fingerprints import fingerprints
from .answers import ESTIMATORS, NEIGHBOURS, Place, configs, maps, queries, verified
from .counting import chosen
from .places import Part, test_part, training_part

Row = dict[str, Any]
Wanted = Mapping[str, tuple[int, ...]]


def answers_of(
    methods: Sequence[str],
    data: Path,
    folder: Path,
    say: Callable[[str], object] = print,
) -> dict[str, dict[str, Any]]:
    """What methods answer to every query, from the folder where it is there and of this code."""
    produced = {name: {"method": fingerprint(name), "stages": fingerprints()} for name in methods}
    found = {name: _stored(folder / f"{name}.json", produced[name]) for name in methods}
    missing = tuple(name for name in methods if not found[name])
    if missing:
        folder.mkdir(parents=True, exist_ok=True)
        for name, measured in run(missing, data, say).items():
            found[name] = {**produced[name], **measured}
            write_text(folder / f"{name}.json", json.dumps(found[name], indent=0) + "\n")
    return found


def _stored(path: Path, produced: Mapping[str, Any]) -> dict[str, Any]:
    if not path.exists():
        return {}
    stored: dict[str, Any] = json.loads(path.read_text("utf-8"))
    same = all(stored.get(key) == value for key, value in produced.items())
    return stored if same else {}


def run(
    methods: Sequence[str], data: Path, say: Callable[[str], object]
) -> dict[str, dict[str, Any]]:
    """Choose the Ks at training places, then localize the test's queries with them."""
    descriptors = {name: create(name, 1) for name in methods}
    training, test = training_part(data), test_part(data)
    every: dict[str, Wanted] = {name: dict.fromkeys(ESTIMATORS, NEIGHBOURS) for name in methods}
    say("mapping the training places")
    trained = _rows(_places(maps(training.mapped, descriptors)), training, descriptors, every)
    ks = {
        name: {each: chosen(trained[name], each, NEIGHBOURS) for each in ESTIMATORS}
        for name in methods
    }
    say(f"K: {ks}; mapping the test's places")
    one: dict[str, Wanted] = {
        name: {each: (k,) for each, k in ks[name].items()} for name in methods
    }
    built = maps(test.mapped, descriptors)
    say("queries")
    answered = _rows(_places(built), test, descriptors, one, ks)
    return {
        name: {
            "neighbours": ks[name],
            "segments": len(built[name]),
            "training": trained[name],
            "test": answered[name],
        }
        for name in methods
    }


def _places(built: Mapping[str, SegmentMap]) -> dict[str, Place]:
    places: dict[str, Place] = {}
    first: Localizer | None = None
    for name, prior_map in built.items():
        places[name] = Place(prior_map, name, first)
        first = first or places[name].base
    return places


def _rows(
    places: Mapping[str, Place],
    part: Part,
    descriptors: Mapping[str, Descriptor],
    wanted: Mapping[str, Wanted],
    verifying: Mapping[str, Mapping[str, int]] | None = None,
) -> dict[str, list[Row]]:
    """The answers of every method to every query; verified ones where Ks for them are given."""
    localizers = {
        name: {
            variant: place.with_config(config)
            for variant, config in configs(name, verifying[name]).items()
        }
        if verifying
        else {}
        for name, place in places.items()
    }
    found: dict[str, list[Row]] = {name: [] for name in places}
    for asked in queries(part, descriptors):
        for name, place in places.items():
            query, truth = asked.described[name], asked.truth
            found[name].append(
                {
                    **asked.row,
                    **place.unverified(query, truth, wanted[name]),
                    **{v: verified(each, query, truth) for v, each in localizers[name].items()},
                }
            )
    return found
