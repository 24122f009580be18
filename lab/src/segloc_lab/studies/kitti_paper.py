"""The paper's protocol on KITTI 00; K is chosen at training places.

Answers are kept as JSON, a file a method: only methods that miss are measured.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, SegmentMap, geometry
from segloc.descriptors import Descriptor, create
from segloc.errors import DatasetError
from segloc.frontend import Segmenter
from segloc.map import compacted
from segloc.proposals import PoseConfig, PoseEstimator, Query
from segloc.system.files import write_text
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path, query_clouds, query_positions
from segloc.tools.datasets import Sequence as Drive
from segloc.types import Float64, Int64, Pose

from ..evaluation.comparison import (
    METHODS,
    build_maps,
    fingerprint,
    published_estimator,
    shared_config,
    with_map_cloud,
)
from ..evaluation.scenario import MAX_GAP_M
from ..evaluation.study import Study, Table
from ..kitti00 import keyframes, poses_of
from ..outcomes import TOLERANCE, pose_error
from ..parallel import in_parallel
from ..report import code, commit, mcnemar, share
from .paper.published import LOCALIZATIONS

LAST_M, EVERY_M = 1300.0, 9.7
"""Clouds localized, and the spacing: 133 clouds (the paper has 134)."""

TRAINING_FROM = 561
"""First keyframe localized to choose K; earlier ones are mapped for that."""


@dataclass(frozen=True)
class Part:
    """A map, and queries from none of its scans.

    Attributes
    ----------
    positions : (N,) int64
        Of the queries in ``queried``.
    distances : (N,) float64
        Of each query to the mapped path, metres.
    """

    mapped: Drive
    queried: Drive
    positions: Int64
    distances: Float64

    @property
    def truths(self) -> Float64:
        """True poses of the queries, (N, 4, 4)."""
        return poses_of(self.queried)[self.positions]


def first_query(data: Path) -> int:
    """Return the keyframe at which the last 1300 m start."""
    drive = keyframes(data)
    way = geometry.distance_travelled(poses_of(drive))
    return int(drive.indices[np.searchsorted(way, way[-1] - LAST_M)])


def test_part(data: Path) -> Part:
    """Return the last 1300 m, a query every 9.7 m, in the map of everything before."""
    first = first_query(data)
    queried = keyframes(data, f"{first}:")
    positions = query_positions(poses_of(queried), EVERY_M, MAX_GAP_M)
    return _part(keyframes(data, f":{first - 1}"), queried, positions)


def training_part(data: Path) -> Part:
    """Return places of the test's map: keyframes near an earlier one, else one every 19.4 m.

    What lies beyond the map's places are the negatives by which thresholds are set. (A mirror image
    of the map is none here: an estimator in SE(3) finds it, upside down.)
    """
    last = first_query(data) - 1
    mapped = keyframes(data, f":{TRAINING_FROM - 1}")
    queried = keyframes(data, f"{TRAINING_FROM}:{last}")
    near = distances_to_path(poses_of(queried), poses_of(mapped)) <= COVERAGE_RADIUS_M
    spread = query_positions(poses_of(queried), 2 * EVERY_M, MAX_GAP_M)
    return _part(mapped, queried, np.union1d(np.flatnonzero(near), spread))


PARTS = {"test": test_part, "training": training_part}


def _part(mapped: Drive, queried: Drive, positions: Int64) -> Part:
    distances = distances_to_path(poses_of(queried)[positions], poses_of(mapped))
    return Part(mapped, queried, positions, distances)


ESTIMATORS = ("published", "votes")
NEIGHBOURS = (25, 200)
"""Choices of K: the paper found 25 best for learned methods, and 200 for the others."""

VERIFIED = ("published, verified", "votes, verified", "everything")
"""The published estimator; votes with up to 4K; the package's default."""

DRAWS = PoseConfig().max_draws
"""Maximum number of PROSAC samples."""

MAP_THREADS = min(4, os.cpu_count() or 1)
"""Threads of a map; maps are built beside nothing else."""

Answer = list[float | None]
"""Errors in metres and degrees (None: no answer, or no truth), and inliers."""
Row = dict[str, Any]
Rows = Sequence[Row]


def verified_as(estimator: str, neighbours: int) -> str:
    """Return the name of an estimator with verification and one K."""
    return f"{estimator} {neighbours}, verified"


def configs(method: str, draws: int = DRAWS) -> dict[str, Config]:
    """Return the configurations with verification: both estimators with every K, and all."""
    base = shared_config(method, 1)
    found = {"everything": base}
    for estimator, escalation in (("published", 1), ("votes", 4)):
        for k in NEIGHBOURS:
            changes = {
                "occupancy": {"enabled": False},
                "matching": {"neighbours": k, "growth": 0.0, "escalation": escalation},
                "pose": {"estimator": _estimator(method, estimator), "max_draws": draws},
            }
            found[verified_as(estimator, k)] = base.model_copy(
                update={
                    name: getattr(base, name).model_copy(update=each)
                    for name, each in changes.items()
                }
            )
    return found


def _estimator(method: str, name: str) -> str:
    return published_estimator(method) if name == "published" else "consensus"


def prior_map(recording: Drive, method: str, path: Path) -> SegmentMap:
    """Return a method's default map, stored in a file."""
    if not path.exists():
        descriptor = create(method, MAP_THREADS)
        (built,) = build_maps(recording, {method: descriptor}, MAP_THREADS).values()
        compacted(built, Config().mapping.compact).save(path)
    return SegmentMap.load(path)


class Place:
    """A map of one method, and its pose estimators."""

    def __init__(self, prior_map: SegmentMap, method: str, draws: int = DRAWS) -> None:
        self._base = Localizer(prior_map, shared_config(method, 1))
        self._method, self._draws = method, draws
        pose = self._base.config.pose.model_copy(update={"max_draws": draws})
        self._estimators = {
            name: PoseEstimator(
                pose.model_copy(update={"estimator": _estimator(method, name)}), threads=1
            )
            for name in ESTIMATORS
        }

    @cached_property
    def _localizers(self) -> dict[str, Localizer]:
        """Return the localizers with verification, on one cloud."""
        base = self._base
        return {
            name: with_map_cloud(base, Localizer(base.prior_map, config))
            for name, config in configs(self._method, self._draws).items()
        }

    def verified(self, query: Query, truth: Pose) -> dict[str, Answer | None]:
        """Return the answer of each variant with verification, or None."""
        found: dict[str, Answer | None] = {}
        for name, localizer in self._localizers.items():
            result = localizer.locate(query)
            T = result.T_map_sensor
            found[name] = None if T is None else _answer(T, truth, result.inliers)
        return found

    def unverified(self, query: Query, truth: Pose) -> dict[str, Answer]:
        """Return the first candidate of each estimator with each K, as "estimator K"."""
        matcher, prior_map = self._base.matcher, self._base.prior_map
        found: dict[str, Answer] = {}
        for k in NEIGHBOURS:
            matches = matcher.prune(query.descriptors, matcher.match(query.descriptors, k))
            for name in ESTIMATORS:
                candidates = self._estimators[name].estimate(
                    query.scene.segments.centroids, prior_map.centroids, matches
                )
                best = candidates[0] if candidates else None
                T = None if best is None else best.T_map_local @ query.cloud.T_local_sensor
                found[f"{name} {k}"] = _answer(T, truth, 0 if best is None else best.inliers)
        return found


def _answer(T: Pose | None, truth: Pose, inliers: int) -> Answer:
    if T is None:
        return [None, None, inliers]
    metres, degrees = pose_error(T, truth)
    return [round(metres, 3), round(degrees, 3), inliers]


def queries(part: Part, descriptor: Descriptor) -> Iterator[tuple[Query, Pose, Row]]:
    """Yield the queries of a part, accumulated, segmented and described; truths, starts of rows."""
    config = Config()
    segmenter = Segmenter(config.segmentation)
    clouds = query_clouds(part.queried, part.positions, config)
    rows = zip(part.positions, part.distances, part.truths, strict=True)
    for (cloud, _), (position, distance, truth) in zip(clouds, rows, strict=True):
        scene = segmenter.segment(cloud)
        keyframe = int(part.queried.indices[position])
        row = {"keyframe": keyframe, "distance": round(float(distance), 2)}
        yield Query(cloud, scene, descriptor.describe(scene.segments)), truth, row


BEYOND_M = 20.0
"""Queries farther from the mapped trajectory are negatives in the choice of K [m]."""


def is_right(answer: Answer) -> bool:
    """Return whether an answer is within the tolerance."""
    metres, degrees, _ = answer
    if metres is None or degrees is None:
        return False
    return metres <= TOLERANCE.metres and degrees <= TOLERANCE.degrees


def threshold(training: Rows, name: str) -> int:
    """Return the minimum inliers that no false answer off the mapped places reaches.

    Some queries from there are answered rightly: they see the map from afar.
    """
    beyond = [row[name] for row in training if row["distance"] > BEYOND_M]
    return max([int(a[2] or 0) for a in beyond if not is_right(a)], default=0) + 1


def chosen(training: Rows, estimator: str, among: Sequence[int]) -> int:
    """Return the K with most training queries and no accepted negative; the smallest of ties."""

    def found(k: int) -> int:
        name = f"{estimator} {k}"
        least = threshold(training, name)
        return sum(row[name][2] >= least and is_right(row[name]) for row in training)

    return max(among, key=lambda k: (found(k), -k))


def outcomes(rows: Rows, name: str, least: int | None = None) -> str:
    """Return one letter per query: ``+`` correct, ``x`` false, ``-`` no answer.

    ``least`` is the number of inliers from which an answer without verification is believed.
    """

    def letter(row: dict[str, Any]) -> str:
        answer = row[name]
        if answer is None or (least is not None and answer[2] < least):
            return "-"
        return "+" if is_right(answer) else "x"

    return "".join(letter(row) for row in rows)


def within_coverage(rows: Rows) -> list[bool]:
    """Return whether each query is within 3 m of the mapped trajectory."""
    return [row["distance"] <= COVERAGE_RADIUS_M for row in rows]


QUERIES = 34
"""Queries per piece."""


@dataclass(frozen=True)
class Piece:
    """Some queries of one part, by one method.

    Attributes
    ----------
    method, part : str
        The part is one of :data:`PARTS`.
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
        """Return the stored answers, in order of the queries."""
        return [json.loads(line) for line in _lines(self._path)]

    @property
    def is_done(self) -> bool:
        """True if all queries are answered."""
        return len(_lines(self._path)) == self.stop - self.first

    @property
    def _path(self) -> Path:
        return self.folder / f"{self.part}-{self.first:03d}.jsonl"

    def build(self) -> None:
        """Build the map, unless it is stored."""
        self._map(PARTS[self.part](self.data))

    def run(self) -> Piece:
        """Answer the remaining queries."""
        if self.is_done:
            return self
        kept = _lines(self._path)
        self._path.write_text("".join(kept), "utf-8")
        part, verify = PARTS[self.part](self.data), self.verify and self.part == "test"
        place = Place(self._map(part), self.method, self.draws)
        some = slice(self.first + len(kept), self.stop)
        part = replace(part, positions=part.positions[some], distances=part.distances[some])
        for query, truth, row in queries(part, create(self.method, 1)):
            row |= place.unverified(query, truth)
            if verify:
                row |= place.verified(query, truth)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        return self

    def _map(self, part: Part) -> SegmentMap:
        return prior_map(part.mapped, self.method, self.folder / f"{self.part}.segmap")


def _lines(path: Path) -> list[str]:
    """Return the complete lines of a file."""
    lines = path.read_text("utf-8").splitlines(keepends=True) if path.exists() else []
    return [line for line in lines if line.endswith("\n")]


Answers = dict[str, Any]


@dataclass(frozen=True)
class Kept:
    """Stored answers of one method, with the code and weights behind them.

    Attributes
    ----------
    folder : Path
        Of all methods.
    produced : dict
        What the answers depend on: those of other code are not used.
    """

    method: str
    folder: Path
    produced: Mapping[str, Any]

    @classmethod
    def of(cls, method: str, folder: Path, data: Path, verify: bool, draws: int) -> Kept:
        """Return the hash of the current code and data."""
        produced: Answers = {"method": fingerprint(method), "code": code(), "verified": verify}
        produced["data"] = hashlib.sha256((data / "keyframes.tum").read_bytes()).hexdigest()[:10]
        if draws != DRAWS:
            produced["draws"] = draws
        return cls(method, folder, produced)

    def read(self) -> Answers | None:
        """Return the answers, if stored by this code."""
        if not self._path.exists():
            return None
        stored: Answers = json.loads(self._path.read_text("utf-8"))
        draws = stored.get("draws") == self.produced.get("draws")
        same = draws and all(stored.get(key) == value for key, value in self.produced.items())
        return stored if same else None

    def pieces(self, data: Path, counts: Mapping[str, int]) -> list[Piece]:
        """Return all pieces of the method; ``counts`` are the queries of each part."""
        self._work.mkdir(parents=True, exist_ok=True)
        posed = (bool(self.produced["verified"]), self.produced.get("draws", DRAWS))
        return [
            Piece(self.method, part, first, min(first + QUERIES, count), data, self._work, *posed)
            for part, count in counts.items()
            for first in range(0, count, QUERIES)
        ]

    def finish(self, pieces: Iterable[Piece]) -> None:
        """Combine the answers of all pieces, and choose K."""
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
    """Return the answers of methods to every query, from the folder if stored by this code.

    Without ``verify`` by inliers alone, which takes a third of the time.
    """
    kept = {name: Kept.of(name, folder, data, verify, draws) for name in methods}
    missing = [each for each in kept.values() if each.read() is None]
    if missing:
        _measure(missing, data, say, workers)
    return {name: each.read() or {} for name, each in kept.items()}


def _measure(
    missing: Sequence[Kept], data: Path, say: Callable[[str], object], workers: int
) -> None:
    counts = {name: len(part(data).positions) for name, part in PARTS.items()}
    pieces = {each.method: each.pieces(data, counts) for each in missing}
    kept = {each.method: each for each in missing}
    every = [piece for part in counts for own in pieces.values() for piece in own
             if piece.part == part]  # fmt: skip
    unmapped = {(piece.method, piece.part): piece for piece in every if not piece.is_done}
    list(in_parallel(Piece.build, list(unmapped.values()), workers))
    left = {name: len(own) for name, own in pieces.items()}
    for number, (_, piece) in enumerate(in_parallel(Piece.run, every, workers), 1):
        name = piece.method
        say(f"{number} of {len(every)}: {name}, {piece.part} from {piece.first} on")
        left[name] -= 1
        if not left[name]:
            kept[name].finish(pieces[name])


def stored(folder: Path) -> dict[str, Answers]:
    """Return the answers of all methods in a folder, by any code."""
    paths = {name: folder / f"{name}.json" for name in METHODS}
    found = {name: json.loads(p.read_text("utf-8")) for name, p in paths.items() if p.exists()}
    if not found:
        raise DatasetError(f"{folder}: no method is measured there to its end")
    return found


PUBLISHED_NAMES = ("segmatch-eigen", "nsm", "segmap", "esm", "dsm")
_KITTI = next(row[5] for row in LOCALIZATIONS if row[0] == "kitti")
PUBLISHED = dict(zip(PUBLISHED_NAMES, _KITTI, strict=True))
NAME = "kitti-paper"
TEXT = """\
The row of Table II that was measured on KITTI 00, on KITTI 00 itself: everything before the last
1300 m is mapped, and a cloud every 9.7 m of the rest is localized. K and the least number of
inliers are chosen for each method at other places of the drive."""
VARIANTS = (ESTIMATORS[0], VERIFIED[0], ESTIMATORS[1], VERIFIED[1], VERIFIED[2])
REFERENCE = "dsm"
_TITLES = {
    "published": "its estimator, inliers alone",
    "published, verified": "its estimator, verified",
    "votes": "votes, inliers alone",
    "votes, verified": "votes, up to 4K, verified",
    "everything": "the package",
}

Stored = Mapping[str, Mapping[str, Any]]


def outcomes_of(answers: Mapping[str, Any]) -> dict[str, str]:
    """Return one letter per query for each variant; see :func:`.counting.outcomes`."""
    found = {}
    for estimator in ESTIMATORS:
        k = answers["neighbours"][estimator]
        least = threshold(answers["training"], f"{estimator} {k}")
        found[estimator] = outcomes(answers["test"], f"{estimator} {k}", least)
        if answers["verified"]:
            verified = outcomes(answers["test"], verified_as(estimator, k))
            found[f"{estimator}, verified"] = verified
    if answers["verified"]:
        found["everything"] = outcomes(answers["test"], "everything")
    return found


def draws_of(stored: Stored) -> int:
    """Return the maximum number of PROSAC samples."""
    found = {each.get("draws", DRAWS) for each in stored.values()}
    if len(found) > 1:
        raise DatasetError(f"methods were given different numbers of draws: {sorted(found)}")
    return int(found.pop())


def _ordered(stored: Stored) -> list[str]:
    return [name for name in METHODS if name in stored]


def study(stored: Stored) -> Study:
    """Return the tables of stored answers."""
    tables = (counts(stored), differences(stored)) if REFERENCE in stored else (counts(stored),)
    return Study(NAME, "The paper's protocol on KITTI 00", tables, text=TEXT)


def counts(stored: Stored) -> Table:
    """Return correct and false localizations by every method and variant."""
    rows = []
    for name in _ordered(stored):
        letters = outcomes_of(stored[name])
        cells = [_count(letters.get(variant)) for variant in VARIANTS]
        k = stored[name]["neighbours"]
        rows.append((name, PUBLISHED.get(name), f"{k['published']}, {k['votes']}", *cells))
    first = stored[_ordered(stored)[0]]["test"]
    note = (
        f"Right localizations of {len(first)} queries, {sum(within_coverage(first))} of them "
        "within 3 m of the mapped path; false ones in brackets where there are any. K: of its "
        "estimator, and of votes. Its estimator: PROSAC, also for `geo` and `profile`, which were "
        f"not published with it, of at most {draws_of(stored) / 1e6:g} million samples; for "
        "SegMatch geometric consistency. The published column has 134 clouds, other weights and "
        "other voxels."
    )
    columns = ("method", "published", "K", *(_TITLES[name] for name in VARIANTS))
    return Table("counts", "Counts", columns, tuple(rows), note)


def _count(letters: str | None) -> str:
    if letters is None:
        return "not measured"
    false = letters.count("x")
    return f"{letters.count('+')}{f' ({false} false)' if false else ''}"


def differences(stored: Stored) -> Table:
    """Return results within coverage with intervals, and exact tests against one method."""
    rows: list[tuple[str, ...]] = []
    covered = within_coverage(next(iter(stored.values()))["test"])
    near = [k for k, flag in enumerate(covered) if flag]
    letters = {name: outcomes_of(stored[name]) for name in _ordered(stored)}
    for name in _ordered(stored):
        cells = []
        for variant in ("published", "everything"):
            if not (variant in letters[name] and variant in letters[REFERENCE]):
                cells += ["not measured", "-"]
                continue
            own, other = letters[name][variant], letters[REFERENCE][variant]
            right = [letter == "+" for letter in own]
            p = mcnemar(right, [letter == "+" for letter in other])
            cells += [
                share(sum(right[k] for k in near), len(near)),
                "-" if name == REFERENCE else f"{p:.2g}",
            ]
        rows.append((name, *cells))
    columns = (
        "method", "its estimator alone: found within coverage", f"p against {REFERENCE}",
        "the package: found within coverage", f"p against {REFERENCE}",
    )  # fmt: skip
    note = (
        "In brackets: 95 % by Wilson. p: McNemar's exact test over all queries, right or not; no "
        "correction for several tests."
    )
    return Table("differences", "Differences", columns, tuple(rows), note)
