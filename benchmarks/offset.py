"""Queries beside the mapped lane: how far from the mapped way a robot can be.

Simulated worlds are mapped along a way in one session; in another (other cars and people, a tenth
of the things replaced), single scans are taken 0 to 15 m to the left and to the right of that way,
wherever there is room for a sensor: nothing within 1.5 m of it. Scans behind walls and inside
houses are among them: nothing says that a query can be found at all.

    python benchmarks/offset.py
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from segloc import Config, Localizer, build_map, geometry
from segloc.evaluation.localization import pose_errors
from segloc.simulation import SCENES, Conditions, SimulatedSequence, hdl64e, simulate_sessions
from segloc.simulation.paths import on_ground
from segloc.types import Float64, Scan

OFFSETS_M = (0.0, 5.0, 10.0, 15.0)
SCENE_SIZE_M = {"town": 200.0, "park": 200.0}
LENGTH_M, ROOM_M = 160.0, 1.5
RIGHT_M, RIGHT_DEG = 1.0, 5.0


def beside(drive: SimulatedSequence, way: Float64, offset_m: float) -> SimulatedSequence:
    """The session seen from so many metres to the left of a way."""
    shift = geometry.yaw_transform(0.0, (0.0, offset_m, 0.0))
    moved = np.stack([T @ shift for T in way])
    yaw = np.array([geometry.heading(T) for T in moved])
    poses = on_ground(drive.world.terrain, moved[:, :2, 3], yaw, drive.sensor.mount_height_m)
    indices = np.arange(len(poses), dtype=np.int64)
    return replace(drive, indices=indices, truth=poses, poses=poses)


def has_room(scan: Scan, mount_height_m: float) -> bool:
    """Whether nothing stands where the sensor does."""
    x, y, z = scan.points.T
    near = (x**2 + y**2 < ROOM_M**2) & (z > 0.4 - mount_height_m)
    return len(scan) > 1000 and not near.any()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--method", default="profile")
    parser.add_argument("--seed", type=int, default=8000)
    parser.add_argument("--every", type=int, default=8, help="scans, 2 m apart, between queries")
    args = parser.parse_args()
    config = Config.preset(args.method)
    print("| scene | beside, m | found | false |\n|---|---|---|---|", flush=True)
    for name, size in SCENE_SIZE_M.items():
        world = SCENES[name](args.seed, size_m=size)
        sessions = [Conditions(), Conditions(replaced=0.1)]
        mapped, again = simulate_sessions(
            world, hdl64e(900), sessions, length_m=LENGTH_M, seed=args.seed
        )
        localizer = Localizer(build_map(mapped, config), config)
        for offset in OFFSETS_M:
            queries = found = false = 0
            for side in (offset, -offset) if offset else (0.0,):
                drive = beside(again, mapped.truth[4 :: args.every], side)
                for i in range(len(drive)):
                    scan = drive.scan(i)
                    if not has_room(scan, drive.sensor.mount_height_m):
                        continue
                    queries += 1
                    T = localizer.localize(scan).T_map_sensor
                    if T is None:
                        continue
                    metres, degrees = pose_errors(T[None], drive.truth[i : i + 1])
                    right = bool(metres[0] < RIGHT_M and degrees[0] < RIGHT_DEG)
                    found, false = found + right, false + (not right)
            print(f"| {name} | {offset:g} | {found} of {queries} | {false} |", flush=True)


if __name__ == "__main__":
    main()
