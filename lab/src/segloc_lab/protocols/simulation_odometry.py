"""LiDAR odometry on simulated drives: how far KISS-ICP drifts.

    python -m segloc_lab.protocols.simulation_odometry

A car with an HDL-64E drives through a town and scans at the sensor's rate, once with a sensor that
moves on while it scans (KISS-ICP de-skews) and once with one that stands still for each scan. The
last row of each drive is the package's own model of odometry. Needs the extras ``sim`` and
``odometry``.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Iterator

import numpy as np
from rich.progress import track

from segloc.geometry import rotation_angle, travelled
from segloc.types import Float64

from ..results.store import Result
from ..script import storing
from ..simulation import PLATFORMS, SENSORS, Route, SimulatedSequence, simulate_session, town

COLUMNS = (
    *("drive", "odometry", "scans", "m", "drift (%)", "drift (degrees in 100 m)"),
    "ms a scan",
)
COMMAND = "python -m segloc_lab.protocols.simulation_odometry"
LENGTHS_M = (25.0, 50.0, 100.0, 200.0)

Row = tuple[str | int | float, ...]


def relative_errors(truth: Float64, odometry: Float64) -> tuple[float, float]:
    """Drift in percent and in degrees a metre: KITTI's mean, over shorter stretches."""
    distances = travelled(truth)
    metres, degrees = [], []
    for first in range(0, len(truth), 5):
        for length in LENGTHS_M:
            last = int(np.searchsorted(distances, distances[first] + length))
            if last >= len(truth):
                continue
            true_step = np.linalg.inv(truth[first]) @ truth[last]
            error = np.linalg.inv(true_step) @ np.linalg.inv(odometry[first]) @ odometry[last]
            metres.append(np.linalg.norm(error[:3, 3]) / length)
            degrees.append(np.degrees(rotation_angle(error)) / length)
    return 100 * float(np.mean(metres)), float(np.mean(degrees))


def kiss_icp(drive: SimulatedSequence) -> tuple[Float64, Float64]:
    """True poses and those of KISS-ICP, which de-skews to where the sensor ends each scan."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.deskew = drive.skew
    config.mapping.voxel_size = config.data.max_range / 100
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses = []
    for i in range(len(drive)):
        scan = drive.scan(i)
        times = np.zeros(0) if scan.times is None else scan.times * drive.sensor.rate_hz
        odometry.register_frame(scan.points.astype(np.float64), times)
        poses.append(odometry.last_pose.copy())
    truth = drive.truth
    if drive.skew and drive.motion is not None and drive.stamps is not None:
        truth = drive.motion.at(drive.stamps + drive.sensor.rays(0.0).times[-1])
    return truth, np.array(poses)


def model(drive: SimulatedSequence) -> tuple[Float64, Float64]:
    """True poses and those of the package's model of odometry."""
    return drive.truth, drive.with_odometry().poses


def judged(
    drive: SimulatedSequence, odometry: Callable[[SimulatedSequence], tuple[Float64, Float64]]
) -> Row:
    """One row."""
    began = time.process_time()
    metres, degrees = relative_errors(*odometry(drive))
    took = time.process_time() - began
    kind = f"{odometry.__name__.replace('_', '-')}, {'skewed' if drive.skew else 'at rest'}"
    length = travelled(drive.truth)[-1]
    spent = round(1000 * took / len(drive))
    drift = (round(metres, 2), round(100 * degrees, 2))
    return drive.world.name, kind, len(drive), round(float(length)), *drift, spent


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--seeds", type=int, nargs="+", default=[7, 8])
    options.add_argument("--length", type=float, default=400.0, help="metres")
    options.add_argument("--sensor", choices=SENSORS, default="hdl64e")
    options.add_argument("--platform", choices=PLATFORMS, default="car")
    options.add_argument("--thin", type=int, default=2, help="every n-th firing of the sensor")
    args = options.parse_args()
    found = (row for seed in args.seeds for row in _drive(seed, args))
    rows = list(track(found, "Following drives", total=3 * len(args.seeds)))
    given = f"--seeds {' '.join(map(str, args.seeds))} --length {args.length:g} --thin {args.thin}"
    given = f"{given} --sensor {args.sensor} --platform {args.platform}"
    command, stages = f"{COMMAND} {given} --store docs/results", ("simulation",)
    Result.measured("simulated-odometry", command, COLUMNS, rows, stages=stages).tell(args.store)


def _drive(seed: int, args: Namespace) -> Iterator[Row]:
    world = town(seed)
    junctions = world.roads.walk(np.random.default_rng(seed), [0], args.length, avoid=[])
    route = Route(tuple(junctions), length_m=args.length)
    sensor, platform = SENSORS[args.sensor]().thinned(args.thin), PLATFORMS[args.platform]()
    for skew in (True, False):
        drive = simulate_session(
            world, 0, route, sensor, seed, platform=platform, by_rate=True, skew=skew
        )
        yield judged(drive, kiss_icp)
    yield judged(drive, model)


if __name__ == "__main__":
    main()
