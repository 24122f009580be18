"""How well maps agree where they meet: in their own frame, and in wrong ones; about ten minutes.

    python -m segloc_lab.protocols.map_agreement DATA

DATA holds ``kitti00/``, ``vlp16_corridor/`` and ``mid360_lab/``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, combinations, permutations
from pathlib import Path

import numpy as np
from rich.progress import track

from segloc import Config, SegmentMap, build_map, geometry, open_sequence
from segloc.map.same_place import MIN_AGREEMENT, MOST_GAIN, meeting
from segloc.map.voxel_cloud import VoxelCloud
from segloc.types import Pose

from ..results.store import Result
from ..script import storing
from ..simulation import Conditions, Lidar, Route, World, hdl64e, simulate_session, town, vlp16
from ..simulation.drives import mapped_way

CONFIG = Config.preset("geo").model_copy(update={"threads": 1})
PARTS = [
    *("169:374", "1414:1601", "948:1000", "1361:1414"),
    *("48:82", "619:655", "655:948", "1004:1361"),
]

COLUMNS = (
    *("maps", "pairs", "meet", "pass"),
    *(f"agreement: {q}" for q in ("least", "median", "95 %", "most")),
    *(f"gain by a turn: {q}" for q in ("least", "median", "95 %", "most")),
)
COMMAND = "python -m segloc_lab.protocols.map_agreement DATA --store docs/results"

Row = tuple[str | int | float, ...]


def moved(prior_map: SegmentMap, T: Pose) -> SegmentMap:
    """The map's path and cloud in another frame."""
    cloud = geometry.transform(T, prior_map.cloud + prior_map.origin)
    origin = cloud.mean(axis=0)
    return SegmentMap(
        prior_map.descriptor,
        prior_map.fingerprint,
        prior_map.columns(),
        VoxelCloud((cloud - origin).astype(np.float32), origin, prior_map.cloud_voxel),
        T @ prior_map.trajectory,
    )


def put_onto(a: SegmentMap, i: int, b: SegmentMap, j: int, turn: float) -> SegmentMap:
    """Map b in a frame in which its pose j is pose i of map a, turned."""
    here, there = geometry.levelled(a.trajectory[i]), geometry.levelled(b.trajectory[j])
    return moved(b, here @ geometry.yaw_transform(turn) @ geometry.inverse(there))


def row(name: str, pairs: Iterable[tuple[SegmentMap, SegmentMap]]) -> Row:
    """How many pairs meet and pass, and how well those that meet agree."""
    found = [meeting(a, b) for a, b in pairs]
    known = [item for item in found if item.agreement is not None]
    passing = sum((i.agreement or 0.0) >= MIN_AGREEMENT and i.gain <= MOST_GAIN for i in known)
    spread = [
        round(float(np.quantile([getattr(item, what) for item in known], q)), 2)
        for what in ("agreement", "gain")
        for q in (0, 0.5, 0.95, 1)
    ]
    return (name, len(found), len(known), passing, *spread)


def kitti(data: Path) -> Iterator[Row]:
    """Parts of one drive, in its frame and put into wrong ones."""
    folder = data / "kitti00" / "keyframes"
    poses = folder.with_suffix(".tum")
    maps = [build_map(open_sequence(folder, poses, part), CONFIG) for part in PARTS]
    yield row("KITTI 00, parts", combinations(maps, 2))
    yield row("KITTI 00, parts in wrong frames", wrong_frames(maps))


def wrong_frames(maps: list[SegmentMap]) -> Iterator[tuple[SegmentMap, SegmentMap]]:
    """Pairs of maps put onto each other somewhere, but for those that come to lie right."""
    rng = np.random.default_rng(1)
    for n in range(240):
        a, b = (maps[k] for k in rng.choice(len(maps), 2, replace=False))
        i, j = int(rng.integers(len(a.trajectory))), int(rng.integers(len(b.trajectory)))
        other = put_onto(a, i, b, j, [0, np.pi, rng.uniform(0, 2 * np.pi)][n % 3])
        if np.linalg.norm(other.trajectory[j, :2, 3] - b.trajectory[j, :2, 3]) > 5:
            yield a, other


def session(world: World, number: int, sensor: Lidar, conditions: Conditions) -> SegmentMap:
    way = tuple(mapped_way(world, np.random.default_rng([2, 31]), 120.0))
    lane = (0.0, 0.5, 0.5, 2.0)[number]
    route = Route(way, lane, 2.0, 70.0)
    return build_map(
        simulate_session(world, number, route, sensor, 2, conditions=conditions), CONFIG
    )


def towns() -> Iterator[Row]:
    """Simulated towns, 60 % of what can be moved replaced; and put onto each other."""
    worlds = [town(seed, size_m=220.0) for seed in (5, 6, 7)]
    firsts = [session(world, 0, hdl64e(300), Conditions()) for world in worlds]
    replaced = Conditions(replaced=0.6)
    for name, number, sensor in (
        ("60 % replaced", 1, hdl64e(300)),
        ("60 % replaced, 2 m beside", 3, hdl64e(300)),
        ("60 % replaced, HDL-64E and VLP-16", 1, vlp16(600)),
    ):
        later = [session(world, number, sensor, replaced) for world in worlds]
        yield row(f"simulated towns, {name}", zip(firsts, later, strict=True))
    others = permutations(firsts, 2)
    wrong = ((a, put_onto(a, 10, b, 10, turn)) for a, b in others for turn in (0.0, np.pi))
    yield row("simulated towns put onto each other", wrong)


def indoors(data: Path) -> Iterator[Row]:
    """A corridor out and back; sessions in a lab, in one frame and each in its own."""
    scans, poses = data / "vlp16_corridor" / "scans", data / "vlp16_corridor" / "poses.tum"
    out, back = (build_map(open_sequence(scans, poses, s), CONFIG) for s in ("0:75", "82:105"))
    yield row("VLP-16 in a corridor, out and back", [(out, back)])
    for frame, name in (("one frame", "poses"), ("a frame each", "poses_own_frame")):
        maps = [
            build_map(open_sequence(folder / "scans", folder / f"{name}.tum"), CONFIG)
            for folder in sorted((data / "mid360_lab").iterdir())
            if folder.is_dir()
        ]
        yield row(f"MID-360 in a lab, sessions of two days, {frame}", combinations(maps, 2))


def main() -> None:
    options = storing(__doc__)
    options.add_argument("data", type=Path)
    args = options.parse_args()
    parts = chain(indoors(args.data), towns(), kitti(args.data))
    rows = list(track(parts, "Maps that meet", total=9))
    stages = ("local cloud", "segmentation", "map", "simulation")
    Result.measured("map-agreement", COMMAND, COLUMNS, rows, stages=stages).tell(args.store)


if __name__ == "__main__":
    main()
