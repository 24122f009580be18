"""How well maps agree where they meet: the table of docs/alignment.md, in about ten minutes.

python tests/map/agreement.py ../shared/data
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from itertools import combinations, permutations
from pathlib import Path

import numpy as np

from segloc import Config, SegmentMap, build_map, geometry, open_sequence
from segloc.map.same_place import MIN_AGREEMENT, MOST_GAIN, meeting
from segloc.map.voxel_cloud import VoxelCloud
from segloc.simulation import Conditions, Route, World, hdl64e, simulate_session, town, vlp16
from segloc.simulation.drives import mapped_way
from segloc.simulation.sensors.lidar import Lidar
from segloc.types import Pose

CONFIG = Config.preset("geo").model_copy(update={"threads": 1})
PARTS = [
    *("169:374", "1414:1601", "948:1000", "1361:1414"),
    *("48:82", "619:655", "655:948", "1004:1361"),
]


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


def show(name: str, pairs: Iterable[tuple[SegmentMap, SegmentMap]]) -> None:
    found = [meeting(a, b) for a, b in pairs]
    known = [item for item in found if item.agreement is not None]
    passing = sum(item.agreement >= MIN_AGREEMENT and item.gain <= MOST_GAIN for item in known)
    print(f"{name}: {len(known)} of {len(found)} meet; {passing} pass; least, median, 95 %, most")
    for what in ("agreement", "gain"):
        values = [getattr(item, what) for item in known]
        spread = " ".join(f"{np.quantile(values, q):.2f}" for q in (0, 0.5, 0.95, 1))
        print(f"  {what}: {spread}", flush=True)


def kitti(data: Path) -> None:
    folder = data / "kitti00" / "keyframes"
    poses = folder.with_suffix(".tum")
    maps = [build_map(open_sequence(folder, poses, part), CONFIG) for part in PARTS]
    show("KITTI 00, parts", combinations(maps, 2))
    show("KITTI 00, wrong frames", wrong_frames(maps))


def wrong_frames(maps: list[SegmentMap]) -> Iterator[tuple[SegmentMap, SegmentMap]]:
    """Pairs of maps put onto each other somewhere, but for those that come to lie right."""
    rng = np.random.default_rng(1)
    for n in range(240):
        a, b = (maps[k] for k in rng.choice(len(maps), 2, replace=False))
        i, j = rng.integers(len(a.trajectory)), rng.integers(len(b.trajectory))
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


def towns() -> None:
    worlds = [town(seed, size_m=220.0) for seed in (5, 6, 7)]
    firsts = [session(world, 0, hdl64e(300), Conditions()) for world in worlds]
    replaced = Conditions(replaced=0.6)
    for name, number, sensor in (
        ("replaced", 1, hdl64e(300)),
        ("replaced, 2 m beside", 3, hdl64e(300)),
        ("VLP-16", 1, vlp16(600)),
    ):
        later = [session(world, number, sensor, replaced) for world in worlds]
        show(f"towns, {name}", zip(firsts, later, strict=True))
    others = permutations(firsts, 2)
    wrong = ((a, put_onto(a, 10, b, 10, turn)) for a, b in others for turn in (0.0, np.pi))
    show("towns, others", wrong)


def indoors(data: Path) -> None:
    scans, poses = data / "vlp16_corridor" / "scans", data / "vlp16_corridor" / "poses.tum"
    out, back = (build_map(open_sequence(scans, poses, s), CONFIG) for s in ("0:75", "82:105"))
    show("VLP-16 in a corridor", [(out, back)])
    for name in ("poses", "poses_own_frame"):
        maps = [
            build_map(open_sequence(folder / "scans", folder / f"{name}.tum"), CONFIG)
            for folder in sorted((data / "mid360_lab").iterdir())
            if folder.is_dir()
        ]
        show(f"MID-360 in a lab, {name}", combinations(maps, 2))


if __name__ == "__main__":
    root = Path(sys.argv[1])
    indoors(root)
    towns()
    kitti(root)
