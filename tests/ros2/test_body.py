"""How the robot is put together: tf, odometry of other frames, and an odometry that leans."""

from __future__ import annotations

import numpy as np
import pytest
from samples.plaza import Plaza
from samples.ros_drive import MOUNT, Listener, on_tf_static
from samples.streams import T_MAP_ODOM, off_m, walked
from segloc_ros.core.body import Body
from segloc_ros.core.frames import Transform, pose_of, position_and_quaternion
from segloc_ros.core.replies import InitialPose, MapToOdom, OdometryReply
from segloc_ros.core.settings import Settings
from segloc_ros.core.transforms import Fixity, TransformTree

from segloc import ConfigError, InvalidScan, Localizer, geometry
from segloc.frontend.mounting import rotation
from segloc.types import Pose

A = geometry.yaw_transform(0.4, (1.0, 2.0, 3.0))
B = geometry.rigid(rotation(10.0, -20.0, 30.0), np.array([0.1, 0.2, 0.3]))


def test_mounts_lead_over_common_frames_and_slashes_are_left_out() -> None:
    tree = TransformTree()
    tree.add([Transform(0.0, "/body", "/base_link", A), Transform(0.0, "body", "mast", B)], True)
    tree.add([Transform(0.0, "mast", "os_sensor", A)], True)
    expected = geometry.inverse(A) @ B @ A
    np.testing.assert_allclose(tree.mount("base_link", "/os_sensor").T, expected, atol=1e-12)
    assert tree.mount("base_link", "elsewhere").fixity is Fixity.MISSING
    assert tree.newest("base_link", "os_sensor") is None


def test_a_joint_is_fixed_if_it_stays_while_the_robot_moves() -> None:
    """Of the joints one is still but for noise, one pans, and one only once the robot drives."""
    tree, rng = TransformTree(), np.random.default_rng(0)

    def drive(k: int, odom_m: float) -> list[Fixity]:
        stamp, noise = 0.1 * k, rng.normal(0.0, 1e-3, 3)
        driven = geometry.yaw_transform(0.0, (odom_m, 0.0, 0.0))
        for name, T in (
            ("still", geometry.rigid(A[:3, :3], A[:3, 3] + noise)),
            ("pan", geometry.yaw_transform(0.01 * k)),
            ("world", geometry.inverse(driven)),
        ):
            tree.add([Transform(stamp, "base", name, T)], False)
        found = [tree.mount("base", name) for name in ("still", "pan", "world")]
        tree.drive(stamp, driven)
        assert all((mount.T is not None) is (mount.fault == "") for mount in found)
        return [mount.fixity for mount in found]

    for k in range(50):  # at rest nothing tells a fixed joint from one that moves with the robot
        at_rest = drive(k, 0.0)
    assert at_rest == [Fixity.UNPROVEN, Fixity.MOVING, Fixity.UNPROVEN]
    for k in range(50, 80):
        driven = drive(k, 0.05 * (k - 49))
    assert driven == [Fixity.FIXED, Fixity.MOVING, Fixity.MOVING]
    np.testing.assert_allclose(tree.mount("base", "still").T[:3, 3], A[:3, 3], atol=5e-3)
    changes = tree.changes
    tree.add([Transform(8.1, "base", "still", A @ geometry.yaw_transform(0.1))], False)
    assert tree.mount("base", "still").fixity is Fixity.MOVING and tree.changes > changes
    assert "base -> still by 5.7 degrees" in tree.mount("base", "still").fault


def test_what_moves_is_interpolated_and_never_made_up() -> None:
    tree = TransformTree(keep_s=5.0)
    for stamp in (10.0, 12.0):
        T = geometry.yaw_transform(0.0, (stamp, 0.0, 0.0))
        tree.add([Transform(stamp, "odom", "foot", T)], False)
    tree.add([Transform(0.0, "foot", "base", A)], True)
    assert tree.newest("odom", "base") == 12.0
    np.testing.assert_allclose(tree.at("odom", "base", 11.0)[:3, 3], [12.0, 2.0, 3.0])
    assert tree.at("odom", "base", 13.0) is None and tree.at("odom", "base", 9.0) is None
    tree.add([Transform(1e4, "odom", "foot", A)], False)
    assert tree.at("odom", "base", 11.0) is None  # forgotten
    tree.add([Transform(20.0, "odom", "foot", A)], False)  # the clock was set back
    assert tree.newest("odom", "base") == 20.0
    tree.add([Transform(19.5, "odom", "foot", A)], False)  # late
    assert tree.newest("odom", "base") == 20.0
    tree.add([Transform(18.0, "odom", "foot", A)], False)  # back by a little more
    assert tree.newest("odom", "base") == 18.0


def test_nonsense_in_tf_is_passed_over() -> None:
    tree = TransformTree()
    nan = np.full((4, 4), np.nan)
    tree.add([Transform(0.0, "a", "b", nan), Transform(np.nan, "a", "b", A)], True)
    tree.add([Transform(0.0, "a", "a", A), Transform(0.0, "", "b", A)], True)
    assert tree.mount("a", "b").T is None
    tree.add([Transform(0.0, "a", "b", A), Transform(0.0, "b", "a", A)], True)  # a circle
    assert tree.mount("a", "nowhere").T is None and tree.mount("x", "a").T is None


def test_poses_keep_their_numbers_through_quaternions() -> None:
    xyz, xyzw = position_and_quaternion(A @ B)
    assert xyzw[3] >= 0
    np.testing.assert_allclose(pose_of(xyz, xyzw), A @ B, atol=1e-12)
    for bad in ([0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.0]):
        with pytest.raises(InvalidScan):
            pose_of([0.0, 0.0, 0.0], bad)


def test_odometry_of_another_body_is_carried_to_the_base() -> None:
    body = Body(Settings())
    assert body.add_odometry(1.0, "odom", "foot", A) == []
    assert "odometry is of foot" in body.faults["odometry"]
    body.add_transforms([Transform(0.0, "foot", "base_link", B)], True)
    ((stamp, T),) = body.add_odometry(2.0, "/odom_lidar", "/foot", A)
    assert stamp == 2.0 and body.odom_frame == "odom_lidar" and "odometry" not in body.faults
    np.testing.assert_allclose(T, A @ B, atol=1e-12)


def test_odometry_by_tf_localizes_too(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, odometry="tf")
    assert "tf odom -> base_link" in listener.robot.faults["odometry"]

    def moved(stamp: float, T_odom_base: Pose) -> None:
        listener.transforms([Transform(stamp, "odom", "base_link", T_odom_base)])

    truth = listener.walk(plaza, 3, odometry=moved)
    assert listener.off(truth) < 0.3
    assert listener.of_kind(MapToOdom)


@pytest.mark.parametrize("gravity", [9.81, 1.0], ids=["m/s2", "g, as Livox"])
def test_an_odometry_that_leans_is_levelled_by_the_imu(
    localizer: Localizer, plaza: Plaza, gravity: float
) -> None:
    """The frame of a LiDAR's odometry begins as the sensor stands: here by 15 degrees."""
    lean = geometry.rigid(rotation(12.0, 9.0, 0.0), np.zeros(3))
    T_map_odom = T_MAP_ODOM @ lean
    listener = Listener.mounted(localizer, imu_topic="imu")
    on_tf_static(listener.robot, B, "imu_link")
    R_map_imu = next(walked(plaza, 1))[1][:3, :3] @ MOUNT[:3, :3].T @ B[:3, :3]
    up = R_map_imu.T @ np.array([0.0, 0.0, gravity])
    listener.walk(plaza, 1, T_map_odom=T_map_odom)
    assert listener.said == [] and "gravity" in listener.robot.faults
    for k in range(100):
        listener.robot.on_acceleration(100.0 + 0.01 * k, "imu_link", up)
    listener.robot.on_acceleration(101.0, "imu_link", np.full(3, np.nan))
    truth = listener.walk(plaza, 3, start_s=101.0, T_map_odom=T_map_odom)
    assert listener.off(truth) < 0.3
    sent = listener.of_kind(MapToOdom)[-1].transform
    assert np.allclose(sent.T_parent_child, T_map_odom, atol=0.3)
    assert (
        np.degrees(geometry.rotation_angle(geometry.inverse(T_map_odom) @ sent.T_parent_child))
        < 1.5
    )


def test_a_robot_that_stands_needs_no_odometry(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(
        localizer, odometry="none", mode="initialpose", trigger="until_localized"
    )
    _, T_map_lidar = next(walked(plaza, 1))
    points = plaza.scan(T_map_lidar, posed=False).points
    for k in range(3):
        listener.cloud(100.0 + 0.1 * k, points)
    (told,) = listener.of_kind(InitialPose)
    truth = T_map_lidar @ geometry.inverse(MOUNT)
    assert off_m(told.pose.T_map_base, truth) < 0.3
    with pytest.raises(ConfigError, match="odometry none"):
        Settings.of({"odometry": "none", "mode": "tf"})


def test_lidar_alone_gives_odometry_and_poses(localizer: Localizer, plaza: Plaza) -> None:
    pytest.importorskip("kiss_icp")
    listener = Listener.mounted(None, odometry="kiss-icp")
    walk = list(walked(plaza, 30, step=0.5, every_s=0.1))
    lidar_base = geometry.inverse(MOUNT)
    for k, (events, T_map_lidar) in enumerate(walk):
        if k == 10:
            listener.robot.use(localizer)  # odometry does not wait for the map
        listener.cloud(events[1].stamp, events[1].scan.points)
        truth = T_map_lidar @ lidar_base
    told = listener.of_kind(OdometryReply)
    assert [t.transform.stamp for t in told] == [events[1].stamp for events, _ in walk]
    assert (told[-1].transform.parent, told[-1].transform.child) == ("odom", "base_link")
    off = geometry.inverse(walk[0][1] @ lidar_base) @ truth
    moved = geometry.inverse(told[0].transform.T_parent_child) @ told[-1].transform.T_parent_child
    assert off_m(moved, off) < 0.3
    assert np.linalg.norm(told[-1].linear) == pytest.approx(5.0, abs=1.0)
    assert listener.off(truth) < 0.3
