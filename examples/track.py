"""A robot that drives on until it is sure: views that agree through odometry are believed.

Every scan is given to the tracker, which gathers those of the last 40 m and asks where they are
every few metres.

python examples/track.py
"""

from __future__ import annotations

from segloc_lab.simulation import Conditions, hdl64e, simulate_sessions, town, vlp16

from segloc import Config, Localizer, build_map
from segloc.tracker import Tracker, TrackerConfig

LENGTH_M = 80.0


def main() -> None:
    world, later = town(7, size_m=150.0), Conditions(foliage=0.7, replaced=0.1)
    first = simulate_sessions(world, hdl64e(600), [Conditions()], length_m=LENGTH_M)[0]
    # Back with another sensor: 16 beams, and odometry in a frame of its own.
    sessions = [Conditions(), later]
    drive = simulate_sessions(world, vlp16(600), sessions, length_m=LENGTH_M)[1].with_odometry()

    config = Config.preset("profile")
    localizer = Localizer(build_map(first, config), config)
    tracker = Tracker(localizer, TrackerConfig(accumulate=True, every_m=6.0))
    for i in range(len(drive)):
        track = tracker.update(drive.scan(i), drive.poses[i])
        where = "not sure yet" if track.T_map_odom is None else f"sure, by {track.views} views"
        print(f"after {drive.indices[i]} scans: {where}")


if __name__ == "__main__":
    main()
