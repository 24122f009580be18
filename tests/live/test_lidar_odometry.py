"""Odometry from the scans alone, and a robot followed by it."""

from __future__ import annotations

import numpy as np
import pytest
from samples.plaza import Plaza
from samples.streams import error_m, feed, walked

from segloc import Localizer, Scan, geometry
from segloc.frontend.mounting import rotation
from segloc.live import LidarOdometry, LiveCore

pytest.importorskip("kiss_icp")
MOUNT = geometry.rigid(rotation(3.0, -8.0, 40.0), np.array([0.5, 0.0, 1.0]))


def test_poses_of_a_tilted_sensor_are_those_of_its_base_in_a_level_frame(plaza: Plaza) -> None:
    odometry = LidarOdometry(MOUNT)
    way = [
        geometry.yaw_transform(0.02 * k + 0.3, (-14.0 + 0.5 * k, 0.1 * k, 0.8)) for k in range(30)
    ]
    for k, T_map_base in enumerate(way):
        scan = plaza.scan(T_map_base @ MOUNT, posed=False, seed=k)
        ((stamp, T),) = odometry.add(scan, 100.0 + 0.1 * k)
    off = geometry.inverse(geometry.inverse(way[0]) @ way[-1]) @ T
    assert stamp == pytest.approx(102.9) and odometry.losses == 0
    assert np.linalg.norm(off[:3, 3]) < 0.3
    assert np.degrees(geometry.rotation_angle(off)) < 1.5


@pytest.mark.parametrize(("gap_s", "why"), [(3600.0, "no scans for 3600"), (0.0, "do not match")])
def test_it_restarts_at_its_last_pose_where_it_was_lost(
    plaza: Plaza, gap_s: float, why: str
) -> None:
    odometry = LidarOdometry()
    told = []
    for k, x in enumerate([*np.linspace(-14.0, -10.0, 9), 20.0, 20.5]):
        scan = plaza.scan(geometry.yaw_transform(0.0, (x, 0.0, 1.8)), posed=False, seed=k)
        told += odometry.add(scan, 100.0 + 0.1 * k + gap_s * (k >= 9))  # from there on elsewhere
    assert odometry.losses == 1 and why in odometry.fault
    step = geometry.inverse(told[8][1]) @ told[-1][1]
    assert np.allclose(step[:3, 3], [0.5, 0.0, 0.0], atol=0.1)
    assert odometry.add(Scan(np.zeros((5, 3))), 101.1 + gap_s) == [] and odometry.losses == 2


def test_times_that_are_all_equal_are_no_motion(plaza: Plaza) -> None:
    timed, plain = LidarOdometry(), LidarOdometry()
    for k in range(3):
        scan = plaza.scan(geometry.yaw_transform(0.0, (0.5 * k, 0.0, 1.8)), posed=False, seed=k)
        ((_, expected),) = plain.add(Scan(scan.points), 100.0 + 0.1 * k)
        *_, (_, T) = timed.add(Scan(scan.points, times=np.full(len(scan), 0.02)), 100.0 + 0.1 * k)
        assert np.array_equal(T, expected)


def test_a_loss_after_the_clock_was_set_back_has_the_new_time(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer)
    pose = geometry.yaw_transform(0.0, (0.0, 0.0, 1.8))
    core.add_odometry(5000.0, pose)
    core.add_scan(plaza.scan(pose, posed=False, seed=0), 5000.0)
    core.add_scan(plaza.scan(pose, posed=False, seed=0), 100.0)
    assert core.report_lost_motion("no scans").stamp == 100.0


def test_a_robot_without_odometry_is_followed_by_its_lidar(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer, lidar_odometry=True)
    walk = walked(plaza, 40, begin=(-14.0, 1.0), step=0.5, every_s=0.1)
    for events, truth in walk:
        states = feed(core, [event for event in events if event.scan is not None])
        if states[-1].localized:
            assert error_m(states[-1], truth) < 0.5
    assert states[-1].localized and core.dropped == 0
    core.report_lost_motion("lifted")
    assert core.state.reason or not core.state.localized
