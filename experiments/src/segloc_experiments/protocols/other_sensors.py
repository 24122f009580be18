"""Other sensors than the one that mapped: a map by an HDL-64E on a car, queries by all others.

Worlds are mapped as in ``change``. In another session (other cars and people, a tenth of the
things replaced) each sensor is driven along the mapped path in another lane, at the height that
robots of its kind carry it at. Its scans are localized one by one, and accumulated by odometry that
drifts.

    python -m segloc_experiments.protocols.other_sensors                    # VLP-16 and OS1-64
    python -m segloc_experiments.protocols.other_sensors --sensors hdl32e os1-128 solid-state
"""

from __future__ import annotations

from dataclasses import replace

from segloc.batch.comparison import build_place
from segloc.descriptors import create
from segloc.simulation import SCENES, SENSORS, Conditions, Lidar, hdl64e

from ..script import parser
from .change import SIZES_M, drives, head, mapped_drive, query_sets, row

MOUNTS_M = {
    "hdl64e": 1.73,
    "os1-128": 2.0,
    "os1-64": 1.9,
    "hdl32e": 1.2,
    "vlp16": 0.8,
    "solid-state": 1.4,
}


def mounted(name: str) -> Lidar:
    """A sensor at the height of its robot."""
    return replace(SENSORS[name](), mount_height_m=MOUNTS_M[name])


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--methods", nargs="+", default=["profile"])
    options.add_argument("--sensors", nargs="+", default=["vlp16", "os1-64"], choices=MOUNTS_M)
    options.add_argument("--worlds", nargs="+", default=["town", "forest"], choices=SIZES_M)
    options.add_argument("--seed", type=int, default=9000)
    options.add_argument("--every", type=int, default=2, help="scans, 2 m apart, between queries")
    options.add_argument("--accumulated-every", type=float, default=6.0, metavar="METRES")
    args = options.parse_args()
    descriptors = {name: create(name, 1) for name in args.methods}
    print(head(args.methods), flush=True)
    for name in args.worlds:
        world = SCENES[name](args.seed, size_m=SIZES_M[name])
        mapped = build_place(mapped_drive(world, args.seed, hdl64e(900)), descriptors)
        for sensor in args.sensors:
            again = drives(world, args.seed, mounted(sensor), Conditions(replaced=0.1))
            queries = query_sets(again["same direction"], args.every, args.accumulated_every)
            for clouds, query_set in queries.items():
                label = f"{name}, {sensor}"
                print(row(label, clouds, mapped, query_set, descriptors), flush=True)


if __name__ == "__main__":
    main()
