"""Contribution of each proposer and each descriptor: found and false without the others.

    python -m segloc_lab.protocols.ablation --report FOLDER

Three places are mapped and queried by single scans without poses: the sample of `segloc demo`, and
a forest and an office floor from the simulator. Queries are scans of a later session along the
mapped way, and scans of another place of the same kind. Each query is answered from segments alone,
with stems added, and with occupancy added (all there is); by each descriptor; and without any
segment match. All descriptors see the same clouds and segments. About three minutes of one core.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from segloc import Localization, Localizer, sample
from segloc.descriptors import Descriptor, create
from segloc.proposals import Query
from segloc.tools.batch import Evaluation
from segloc.types import Candidate, Float64, Matches, Pose, Recording

from ..evaluation.comparison import build_maps, shared_config, with_map_cloud
from ..recordings import Unposed
from ..report import Cell, Table, publish, reporting, share
from ..simulation import SCENES, Conditions, Route, World, os1_64, simulate_session
from ..simulation.drives import lane, mapped_way

PROPOSERS = ("segments", "+ stems", "+ occupancy")
"""Each row also has the proposers of the rows above it."""

NO_MATCHES = "no segments"
LENGTH_M = 120.0
SIZES_M = {"forest": 140.0, "offices": 60.0}
LATER = Conditions(foliage=0.5, replaced=0.15)


class NoMatches:
    """Propose no poses from segments."""

    def estimate(self, query: Float64, map_centroids: Float64, matches: Matches) -> list[Candidate]:
        """Return no candidates."""
        return []

    def agreement(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> Callable[[Pose], int]:
        """Return no inliers at any pose."""
        return lambda T_map_local: 0


@dataclass(frozen=True)
class Place:
    """The recording of a map, queries in it with true poses, and queries of another place."""

    name: str
    mapped: Recording
    inside: Recording
    truths: Float64
    elsewhere: Recording


def sample_place() -> Place:
    """Return the sample of `segloc demo`."""
    tuesday, elsewhere = sample.load("tuesday"), sample.load("elsewhere")
    truths, monday = tuesday.truth, sample.load("monday")
    return Place("sample", monday, Unposed(tuesday), truths, Unposed(elsewhere))


def simulated_place(kind: str, seed: int) -> Place:
    """Simulate a place, a later session in the opposite direction, and another of its kind."""
    sensor = os1_64(512)
    here, way = _world(kind, seed)
    there, away = _world(kind, seed + 1000)
    mapped = Route(way, lane(here, 0), length_m=LENGTH_M)
    back = Route(way[::-1], lane(here, 1), spacing_m=4.0, length_m=LENGTH_M)
    other = Route(away, lane(there, 0), spacing_m=4.0, length_m=LENGTH_M)
    inside = simulate_session(here, 1, back, sensor, seed + 1, conditions=LATER)
    return Place(
        kind,
        simulate_session(here, 0, mapped, sensor, seed),
        Unposed(inside),
        inside.truth,
        Unposed(simulate_session(there, 0, other, sensor, seed + 2)),
    )


def _world(kind: str, seed: int) -> tuple[World, tuple[int, ...]]:
    world = SCENES[kind](seed, size_m=SIZES_M[kind])
    return world, tuple(mapped_way(world, np.random.default_rng([seed, 31]), LENGTH_M))


def localizers(
    place: Place, descriptors: Mapping[str, Descriptor]
) -> dict[tuple[str, str], Localizer]:
    """Return localizers by descriptor and last proposer, on one cloud; and one without matches."""
    maps = build_maps(place.mapped, descriptors)
    name = next(iter(maps))
    config = shared_config(name, 1).model_copy(update={"proposers": ("stems",)})
    first = Localizer(maps[name], config)
    found = {}
    for name, prior_map in maps.items():
        for count, last in enumerate(PROPOSERS):
            found[name, last] = Localizer(
                prior_map,
                shared_config(name, 1),
                proposers=first.proposers[:count],
                likelihood=first.likelihood,
            )
    found[NO_MATCHES, PROPOSERS[-1]] = with_map_cloud(first, first, NoMatches())
    return found


def answers(
    recording: Recording,
    ways: Mapping[tuple[str, str], Localizer],
    descriptors: Mapping[str, Descriptor],
) -> dict[tuple[str, str], list[Localization]]:
    """Localize each scan in every way; each is accumulated and segmented once."""
    found: dict[tuple[str, str], list[Localization]] = {way: [] for way in ways}
    first = next(iter(ways.values()))
    for i in range(len(recording)):
        query = first.describe(recording.scan(i))
        described = {
            name: each.describe(query.scene.segments) for name, each in descriptors.items()
        }
        for (name, last), localizer in ways.items():
            vectors = described.get(name, query.descriptors)
            result = localizer.locate(Query(query.cloud, query.scene, vectors))
            found[name, last].append(result)
    return found


def rows(place: Place, descriptors: Mapping[str, Descriptor]) -> Iterator[tuple[Cell, ...]]:
    """Count found and false answers in a place, one row per way."""
    ways = localizers(place, descriptors)
    path = next(iter(ways.values())).prior_map.trajectory
    inside = answers(place.inside, ways, descriptors)
    elsewhere = answers(place.elsewhere, ways, descriptors)
    for (name, last), results in inside.items():
        scored = Evaluation(place.inside.indices, results, path, place.truths)
        covered = scored.within_coverage
        found = share(int(scored.correct[covered].sum()), int(covered.sum()))
        away = sum(result.localized for result in elsewhere[name, last])
        false = f"{int(scored.false.sum())} + {away}"
        total = f"{len(results)} + {len(elsewhere[name, last])}"
        yield place.name, name, last, found, false, total


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--methods", nargs="+", default=["profile", "dsm", "geo"])
    options.add_argument("--places", nargs="+", default=["sample", *SIZES_M])
    options.add_argument("--seed", type=int, default=4100, help="of the simulated places")
    args = options.parse_args()
    descriptors = {name: create(name, 1) for name in args.methods}
    table: list[tuple[Cell, ...]] = []
    for name in args.places:
        place = sample_place() if name == "sample" else simulated_place(name, args.seed)
        for row in rows(place, descriptors):
            print(*row, sep="  ", flush=True)
            table.append(row)
    columns = ("place", "descriptor", "proposers", "found within coverage", "false", "queries")
    note = (
        "Each row of a descriptor also has the proposers of the rows above it. False and queries: "
        "in the mapped place + of another place of its kind. In brackets 95 % by Wilson."
    )
    publish(
        args.report, "What each proposer and each descriptor brings", Table(columns, table, note)
    )


if __name__ == "__main__":
    main()
