"""The ROS node's core on a simulated drive: what it tells, and when it keeps silent."""

from __future__ import annotations

import sys
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from samples.maps import repeated
from samples.on_board import BODY, beside, with_mast
from samples.plaza import Plaza
from samples.ros_drive import (
    LIDAR,
    MOUNT,
    Listener,
    cloud_of,
    livox_of,
    on_tf_static,
)
from samples.streams import T_MAP_ODOM, Event, off_m, walked
from samples.usage import resident_mb
from segloc_ros.core.clicks import Click
from segloc_ros.core.diagnosis import Level, StateStatus, TfState, diagnose, robot_state
from segloc_ros.core.frames import Transform
from segloc_ros.core.maps import MapFile
from segloc_ros.core.replies import (
    CandidatesReply,
    InitialPose,
    MapToOdom,
    MatchesReply,
    OdometryReply,
    PoseReply,
)
from segloc_ros.core.trigger import Trigger

from segloc import ConfigError, InvalidScan, Localizer, Prior, geometry
from segloc.frontend.mounting import rotation
from segloc.map.georeference import KEY, Georeference
from segloc.tiles import cut_tiles
from segloc.types import Pose

HERE = Georeference(25832, (691_600.25, 5_336_000.5, 520.0))


def test_a_drive_gives_poses_of_the_base_and_map_to_odom(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer)
    truth = listener.walk(plaza, 6)
    poses, transforms = listener.of_kind(PoseReply), listener.of_kind(MapToOdom)
    assert off_m(poses[-1].T_map_base, truth) < 0.3 and poses[-1].frame == "map"
    last = transforms[-1].transform
    assert (last.parent, last.child) == ("map", "odom")
    assert np.allclose(last.T_parent_child, T_MAP_ODOM, atol=0.3)
    assert last.stamp == pytest.approx(105.2 + 0.2)  # of the newest odometry, post-dated
    assert len(listener.of_kind(InitialPose)) == 1  # told once: what followed agreed with it
    shown = listener.of_kind(MatchesReply)[-1]
    assert shown.accepted and len(shown.centroids) > 5
    told = diagnose(listener.robot)
    assert told.level is Level.OK and told.message == "localized"
    assert float(told.values["total_ms"]) > 0 and "segmentation_ms" in told.values
    assert told.values["last query"] == "accepted"


def test_poses_for_a_tracker_leave_room_and_those_beside_do_not(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, initialpose_least_m=0.5, initialpose_least_deg=10.0)
    listener.walk(plaza, 2)
    (told,) = listener.of_kind(InitialPose)
    metres, radians = np.sqrt(np.diag(told.pose.covariance))[[0, 5]]
    assert 0.5 < metres < 0.6 and np.radians(10.0) < radians < np.radians(12.0)
    assert np.sqrt(listener.of_kind(PoseReply)[-1].covariance[0, 0]) < 0.3


def test_covariances_are_in_ros_order_and_axes(localizer: Localizer, plaza: Plaza) -> None:
    """Poses are drawn as the state says, by motions in the base; their spread is what is told."""
    listener = Listener.mounted(localizer)
    listener.walk(plaza, 3)
    told, state = listener.of_kind(PoseReply)[-1], listener.robot.state
    rng = np.random.default_rng(0)
    spread = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.4])
    draws = rng.multivariate_normal(np.zeros(6), spread**2, 40_000)
    T = told.T_map_base
    moved = T[:3, 3] + draws[:, 3:] @ T[:3, :3].T
    turned = draws[:, :3] @ T[:3, :3].T  # R exp(w) = exp(R w) R: about the map's axes
    expected = np.cov(np.column_stack([moved - T[:3, 3], turned]).T)
    found = PoseReply.of(0.0, "map", T, spread**2).covariance
    np.testing.assert_allclose(found, expected, atol=0.003)
    assert state.covariance is not None and np.linalg.eigvalsh(told.covariance).min() > 0


def test_nothing_is_told_while_it_is_not_known_where_the_lidar_is(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.of(localizer)
    listener.walk(plaza, 3)
    assert listener.said == []
    told = diagnose(listener.robot)
    assert told.level is Level.WARN
    assert told.message.startswith("no transform base_link -> os_sensor in tf: publish it on")
    on_tf_static(listener.robot)
    truth = listener.walk(plaza, 3, start_s=103.0, begin=(-8.0, 1.3))
    assert listener.off(truth) < 0.3


def test_a_mount_by_parameter_needs_no_tf(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.of(localizer, base_to_lidar=[1.5, 0.2, 0.3, 0.0, 0.0, 0.7])
    truth = listener.walk(plaza, 2)
    assert listener.off(truth) < 0.3
    with pytest.raises(ConfigError, match="base_to_lidar"):
        Listener.of(base_to_lidar=[1.0, 2.0])


def test_a_mount_that_changes_begins_anew(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.of(localizer)
    on_tf_static(listener.robot, np.eye(4))
    listener.walk(plaza, 2)
    core = listener.robot.core
    on_tf_static(listener.robot, MOUNT)
    truth = listener.walk(plaza, 3, start_s=102.0, begin=(-10.0, 1.2))
    assert listener.robot.core is not core
    assert listener.off(truth) < 0.3


def test_modes_tell_only_what_was_asked_for(localizer: Localizer, plaza: Plaza) -> None:
    for mode, silent in (("initialpose", MapToOdom), ("tf", InitialPose)):
        listener = Listener.mounted(localizer, mode=mode)
        listener.walk(plaza, 2)
        assert not listener.of_kind(silent) and listener.of_kind(PoseReply)


def test_until_localized_it_works_and_then_rests(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, trigger="until_localized")
    listener.walk(plaza, 1)
    assert listener.robot.trigger.resting and len(listener.of_kind(InitialPose)) == 1
    queries = listener.robot.last
    listener.clear()
    listener.walk(plaza, 5, start_s=101.0, begin=(-12.0, 1.1))
    assert listener.robot.last is queries  # none was made
    assert listener.of_kind(PoseReply) == [] and len(listener.of_kind(MapToOdom)) > 4
    assert diagnose(listener.robot).message == "localized, at rest"
    # An odometry that begins anew wakes it.
    T = geometry.inverse(geometry.yaw_transform(-2.0, (9.0, 80.0, 1.0)))
    truth = listener.walk(plaza, 3, start_s=106.0, begin=(-2.0, 1.6), T_map_odom=T)
    assert off_m(listener.of_kind(InitialPose)[-1].pose.T_map_base, truth) < 7.0
    assert listener.robot.trigger.resting and listener.robot.fixes == 2


@pytest.mark.parametrize("trigger", ["until_localized", "periodic"])
def test_an_update_without_motion_checks_the_pose_and_keeps_it(
    localizer: Localizer, plaza: Plaza, trigger: str
) -> None:
    listener = Listener.mounted(localizer, trigger=trigger, mode="initialpose", query_every_s=100.0)
    listener.walk(plaza, 3, step=0.0)
    rests, last = listener.robot.trigger.resting, listener.robot.last
    listener.walk(plaza, 2, start_s=103.0, step=0.0)
    assert listener.robot.last is last  # none is due
    listener.clear()
    listener.robot.request_update()
    truth = listener.walk(plaza, 3, start_s=105.0, step=0.0)
    assert listener.robot.last is not last and listener.robot.fixes == 1
    assert not listener.of_kind(InitialPose)  # it was right
    assert all(off_m(reply.T_map_base, truth) < 0.3 for reply in listener.of_kind(PoseReply))
    assert listener.robot.trigger.resting == rests and robot_state(listener.robot, True).localized
    last = listener.robot.last
    listener.walk(plaza, 2, start_s=108.0, step=0.0)
    assert listener.robot.last is last  # one was asked for


def test_an_update_of_a_robot_that_rests_without_a_pose_is_ignored(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, trigger="service")
    listener.robot.request_update()
    listener.walk(plaza, 2)
    assert listener.robot.last is None and listener.robot.trigger.resting


@pytest.mark.parametrize("kept", ["drop", "keep"])
def test_a_lost_robot_drops_or_keeps_map_to_odom_and_its_state_tells_which(
    localizer: Localizer, plaza: Plaza, kept: str
) -> None:
    listener = Listener.mounted(localizer, tf_when_lost=kept, mode="tf")
    T_odom_base = geometry.inverse(T_MAP_ODOM) @ listener.walk(plaza, 3)
    assert robot_state(listener.robot, True).map_to_odom is TfState.CURRENT
    listener.robot.relocalize()
    listener.clear()
    listener.odometry(103.5, T_odom_base)
    sent = [reply.transform.T_parent_child for reply in listener.of_kind(MapToOdom)]
    state, told = robot_state(listener.robot, True), diagnose(listener.robot)
    assert state.status is StateStatus.LOST and not state.localized
    assert len(sent) == (kept == "keep")
    if kept == "keep":
        assert np.allclose(sent[0], T_MAP_ODOM, atol=0.5)
        assert state.map_to_odom is TfState.KEPT and "map -> odom is kept" in told.message
        listener.robot.use(localizer)  # another frame
    listener.clear()
    listener.odometry(103.7, T_odom_base)
    assert not listener.of_kind(MapToOdom)
    assert robot_state(listener.robot, True).map_to_odom is TfState.NONE


def test_the_state_for_programs(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.of(trigger="until_localized", map="/maps/site.segmap")
    state = robot_state(listener.robot, True)
    assert (state.status, state.reason) == (StateStatus.LOST, "the map is being read")
    assert diagnose(listener.robot).level is Level.WARN
    listener.robot.use(localizer)
    assert "no cloud yet" in robot_state(listener.robot, True).reason
    on_tf_static(listener.robot)
    listener.walk(plaza, 2)
    state = robot_state(listener.robot, True)
    assert state.status is StateStatus.LOCALIZED and state.localized and state.at_rest
    assert state.confidence > 0.97 and state.reason == "" and state.map_url == "/maps/site.segmap"
    assert state.stamp == pytest.approx(101.2)  # of the newest odometry
    listener.robot.behind_s = 2.0
    late = diagnose(listener.robot)
    assert late.level is Level.WARN and "processed 2.0 s late" in late.message
    listener.robot.behind_s = 0.0
    listener.cloud(101.5, np.full((9, 3), np.nan))
    state = robot_state(listener.robot, True)
    assert state.localized and "cloud refused" in state.reason
    assert robot_state(listener.robot, False).status is StateStatus.INACTIVE


def test_by_service_it_looks_only_when_called(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, trigger="service")
    listener.walk(plaza, 2)
    assert not listener.said and diagnose(listener.robot).message == "at rest: call ~/relocalize"
    fixes = listener.robot.relocalize()
    listener.walk(plaza, 1, start_s=102.0, begin=(-10.0, 1.2))
    assert listener.robot.fixes == fixes + 1 and listener.of_kind(InitialPose)
    listener.walk(plaza, 1, start_s=103.0, begin=(300.0, 1.2))  # a jump, and it may not look
    assert "call ~/relocalize" in diagnose(listener.robot).message
    assert listener.robot.T_map_odom is None


def test_a_cloud_without_odometry_has_no_pose(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer)
    listener.walk(plaza, 2)
    assert listener.of_kind(PoseReply)
    listener.clear()
    for stamp in (103.0, 104.0, 105.0):
        listener.cloud(stamp, plaza.scan(MOUNT, posed=False).points)
    assert listener.robot.core is not None and listener.robot.core.dropped
    assert not listener.of_kind(PoseReply)


def fix(xyz: tuple[float, float, float], sigma_m: float) -> Any:
    """sensor_msgs/NavSatFix at a position of the georeferenced map."""
    longitude, latitude, altitude = HERE.on_globe(np.array([xyz]))[0]
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0)),
        status=SimpleNamespace(status=0), longitude=longitude, latitude=latitude,
        altitude=altitude, position_covariance=(np.eye(3) * sigma_m**2).ravel(),
        position_covariance_type=2,
    )  # fmt: skip


def test_gnss_says_where_to_search_first_and_a_wrong_fix_is_survived(
    localizer: Localizer, plaza: Plaza
) -> None:
    pytest.importorskip("pyproj")
    for position, begin in (((-14.0, 1.0, 0.0), -14.0), ((16.0, 4.0, 0.0), -14.0)):
        listener = Listener.mounted(localizer, fix_topic="fix", mode="initialpose", matches=False)
        listener.robot.on_fix(fix(position, 1.0))
        listener.walk(plaza, 1, begin=(begin, 1.0))
        assert "missing fix" in diagnose(listener.robot).values  # the map has no georeference
        localizer.prior_map.metadata[KEY] = HERE.to_text()
        try:
            listener.robot.relocalize()
            listener.robot.on_fix(fix(position, 1.0))
            truth = listener.walk(plaza, 2, start_s=101.0, begin=(begin, 1.0), step=0.5)
        finally:
            del localizer.prior_map.metadata[KEY]
        assert "missing fix" not in diagnose(listener.robot).values
        assert listener.off(truth) < 0.3
        places = listener.of_kind(CandidatesReply)[-1].places
        assert off_m(places[0][0], truth) < 1.0 and places[0][1] > 0.9
        assert float(diagnose(listener.robot).values["candidates"].split()[0]) > 0.9


def test_a_height_in_the_map_tells_storeys_apart(localizer: Localizer, plaza: Plaza) -> None:
    up = geometry.yaw_transform(0.0, (0.0, 0.0, 30.0))
    storeys = Localizer(repeated(localizer.prior_map, up[:3, 3]))
    listener = Listener.mounted(storeys, height_topic="height", height_sigma_m=0.3)
    assert listener.robot.on_height(99.0, "map", 1.5, 0.0) == []  # no clouds yet
    listener.walk(plaza, 2, carried=up)
    assert listener.robot.T_map_odom is None
    for k in range(3):
        listener.hear(listener.robot.on_height(102.0 + k, "/map", 31.5, 0.25 * (k > 0)))
        at = {"start_s": 102.0 + k, "begin": (-10.0 + 2 * k, 1.2)}
        truth = listener.walk(plaza, 1, carried=up, **at)
    assert listener.off(truth) < 0.3
    for frame, metres, variance in (
        ("odom", 1.5, 0.1), ("", 1.5, 0.1), ("map", np.nan, 0.1), ("map", 1.5, -1.0),
        ("map", 1.5, np.nan), ("map", 1.5, np.inf),
    ):  # fmt: skip
        with pytest.raises(InvalidScan, match="height"):
            listener.robot.on_height(105.0, frame, metres, variance)
    assert diagnose(listener.robot).values["unused heights"] == "0"


def test_a_click_is_refined_and_its_echo_is_not_taken_for_another(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, mode="initialpose", click_topic="/initialpose")
    listener.walk(plaza, 2)
    (first,) = listener.of_kind(InitialPose)
    told = Click("map", first.pose.T_map_base, first.pose.covariance)
    assert listener.robot.on_click(told) == "an echo"
    near = geometry.yaw_transform(0.0, (-9.0, 3.0, 0.0))
    assert listener.robot.on_click(Click("/map", near, np.eye(6))) == ""
    assert listener.robot.T_map_odom is None
    truth = listener.walk(plaza, 1, start_s=102.0, begin=(-10.0, 1.2))
    assert off_m(listener.of_kind(InitialPose)[-1].pose.T_map_base, truth) < 0.3
    assert "odom" in listener.robot.on_click(Click("odom", near, np.eye(6)))


def test_a_click_elsewhere_finds_nothing_there_and_then_anything(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, click_s=3.0, click_radius_m=5.0)
    listener.walk(plaza, 2)
    far = geometry.yaw_transform(0.0, (500.0, 0.0, 0.0))
    listener.robot.on_click(Click("map", far, np.zeros((6, 6))))
    listener.clear()
    listener.walk(plaza, 2, start_s=102.0, begin=(-10.0, 1.2))
    assert not listener.of_kind(PoseReply)
    assert "within 5 m of 500, 0" in diagnose(listener.robot).values["last query"]
    listener.walk(plaza, 5, start_s=104.0, begin=(-6.0, 1.4))
    assert listener.of_kind(PoseReply)


def test_the_radius_of_a_prior_follows_its_covariance() -> None:
    T = geometry.yaw_transform(1.0, (3.0, 4.0, 5.0))
    wide = Click("map", T, np.diag([100.0, 1.0, 1.0, 0.0, 0.0, 0.0])).prior(10.0)
    assert isinstance(wide, Prior) and wide.radius_m == pytest.approx(30.0)
    assert np.allclose(wide.position, [3.0, 4.0])
    assert Click("map", T, np.full((6, 6), np.nan)).prior(10.0).radius_m == 10.0


def test_the_map_may_come_late_and_be_replaced(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted()
    listener.robot.maps.fault = "no map: site.segmap: No such file or directory"
    listener.walk(plaza, 2)
    assert listener.said == [] and diagnose(listener.robot).level is Level.ERROR
    listener.robot.use(localizer)
    listener.walk(plaza, 2, start_s=102.0, begin=(-10.0, 1.2))
    assert listener.of_kind(PoseReply)
    listener.robot.use(localizer)
    assert listener.robot.T_map_odom is None
    listener.robot.maps.fault = "no map: it is gone"  # the one in use stays
    listener.clear()
    listener.walk(plaza, 2, start_s=104.0, begin=(-6.0, 1.4))
    assert listener.of_kind(InitialPose)
    told = diagnose(listener.robot)
    assert told.level is Level.ERROR
    assert told.message == "localized; the map in use stays: no map: it is gone"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_is_flat_after_a_cloud_of_5_million_points(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer)
    truth = listener.walk(plaza, 6)
    before_mb = resident_mb()
    rng = np.random.default_rng(0)
    points = np.tile(plaza.scan(truth @ MOUNT, posed=False).points, (200, 1))[:5_000_000]
    listener.cloud(106.0, points + rng.normal(0.0, 0.01, points.shape).astype(np.float32))
    listener.odometry(106.2, np.asarray(listener.robot.state.T_odom_base))
    assert listener.robot.points > 1_000_000
    del points
    listener.walk(plaza, 8, start_s=107.0)
    assert resident_mb() < before_mb + 60.0


def test_in_another_map_of_the_frame_it_is_searched_near_its_pose(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, trigger="until_localized", click_radius_m=5.0)
    listener.walk(plaza, 2)
    listener.robot.switch(localizer, np.eye(4))
    assert listener.robot.T_map_odom is None
    listener.clear()
    truth = listener.walk(plaza, 1, start_s=102.0, begin=(-10.0, 1.2))
    assert off_m(listener.of_kind(InitialPose)[-1].pose.T_map_base, truth) < 0.3
    assert listener.robot.trigger.resting


def test_an_answer_in_a_map_that_was_replaced_is_passed_over(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, click_topic="")
    due, requests = listener.robot.due, []
    listener.robot.due = lambda: requests.append(due()) or None  # nobody makes them
    listener.walk(plaza, 1)
    request = next(each for each in requests if each)
    made = listener.robot.ask(request)
    listener.robot.use(localizer)
    assert listener.robot.answer(request, made) == [] and listener.robot.last is None


def test_clouds_that_cannot_be_used_and_late_ones_end_nothing(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer)
    listener.walk(plaza, 3)
    cloud = cloud_of(np.ones((50, 3)))
    cloud.fields = cloud.fields[:2]
    assert listener.robot.on_cloud(cloud, 102.5, LIDAR) == []
    assert "cloud refused: no field 'z'" in diagnose(listener.robot).message
    listener.cloud(101.5, np.ones((50, 3)))
    assert listener.robot.core.dropped == 1
    truth = listener.walk(plaza, 2, start_s=103.0, begin=(-8.0, 1.3))
    assert listener.off(truth) < 0.3
    assert diagnose(listener.robot).message == "localized"


def test_clouds_of_two_lidars_on_one_topic_are_not_mixed(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer)
    on_tf_static(listener.robot, np.eye(4), "rear")
    listener.walk(plaza, 2)
    core = listener.robot.core
    listener.cloud(101.5, np.ones((50, 3)), "rear")
    assert "clouds in rear and in os_sensor on one topic" in diagnose(listener.robot).message
    assert listener.robot.core is core
    listener.cloud(110.0, np.ones((50, 3)), "rear")  # the other has fallen silent
    assert listener.robot.core is not core


def test_clouds_of_two_lidars_are_merged_by_mounts_and_stamps(
    localizer: Localizer, plaza: Plaza
) -> None:
    """Each sees half of the surroundings, the rear one 50 ms later; at last it falls silent."""
    rear = geometry.yaw_transform(-2.0, (-1.0, -0.3, 0.1))
    listener = Listener.mounted(localizer, more_points_topics=["rear"])
    on_tf_static(listener.robot, rear, "rear_lidar")
    lidar_base = geometry.inverse(MOUNT)
    for k, (events, T_map_lidar) in enumerate(walked(plaza, 8, every_s=0.5)):
        truth = T_map_lidar @ lidar_base
        later = truth @ geometry.yaw_transform(0.0, (0.2, 0.0, 0.0))
        halves = []
        for T, mount in ((truth, MOUNT), (later, rear)):
            points = plaza.scan(T @ mount, posed=False, seed=k).points
            halves.append(points[(points @ mount[:2, :3].T[:, 0] > 0) == (mount is MOUNT)])
        before, main, behind = events
        listener.odometry(before.stamp, before.T_odom_base @ lidar_base)
        listener.cloud(main.stamp, halves[0])
        if k < 6:
            listener.cloud(main.stamp + 0.05, halves[1], "rear_lidar", "rear")
        listener.odometry(behind.stamp, behind.T_odom_base @ lidar_base)
        if k == 5:
            error = listener.off(truth)
    assert error < 0.3 and listener.robot.core.scans == 7  # the last one still waits
    assert "no clouds of rear" in diagnose(listener.robot).message


def test_a_pose_without_a_covariance_is_told_with_a_wide_one() -> None:
    told = PoseReply.of(1.0, "map", np.eye(4), None)
    assert np.allclose(np.sqrt(np.diag(told.covariance))[[0, 5]], [1.0, np.radians(5.0)])


def test_silence_is_said(
    localizer: Localizer, plaza: Plaza, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(now=10.0, perf_counter=time.perf_counter)
    clock.monotonic = lambda: clock.now
    monkeypatch.setattr("segloc_ros.core.robot.time", clock)
    listener = Listener.mounted(localizer, silent_s=1.5)
    listener.walk(plaza, 3)
    listener.robot.report_silence()
    assert diagnose(listener.robot).message == "localized"
    clock.now += 1.6
    listener.robot.report_silence()
    told, state = diagnose(listener.robot), listener.robot.state
    assert told.level is Level.WARN and "no data received for 1.6 s" in told.message
    listener.robot.report_silence()
    assert listener.robot.state is state  # once


def test_a_smooth_transform_agrees_with_the_pose_and_its_covariance_says_so(
    localizer: Localizer, plaza: Plaza
) -> None:
    """Odometry steps by 1 m, too little to be noticed as a jump: the correction takes seconds."""
    rate = {"smooth_tf_mps": 0.1, "smooth_tf_dps": 1.0, "mode": "tf"}
    listener = Listener.mounted(localizer, smooth_tf=True, **rate)
    listener.walk(plaza, 3, step=0.5)
    listener.clear()
    slipped = T_MAP_ODOM @ geometry.yaw_transform(0.0, (0.7, 0.0, 0.0))
    truth = listener.walk(plaza, 6, start_s=103.0, begin=(-12.0, 1.3), step=0.5, T_map_odom=slipped)
    sent = [reply.transform for reply in listener.of_kind(MapToOdom)]
    for a, b in pairwise(sent):
        moved = np.linalg.norm((b.T_parent_child - a.T_parent_child)[:3, 3])
        assert moved < 0.1 * (b.stamp - a.stamp) + 0.05
    pose = listener.of_kind(PoseReply)[-1]
    error = off_m(pose.T_map_base, truth)
    assert (
        0.1 < error < 0.8 and np.sqrt(pose.covariance[0, 0] + pose.covariance[1, 1]) > 0.5 * error
    )


def registered(plaza: Plaza, listener: Listener, frame: str, count: int = 6) -> Pose:
    """Walk with clouds in the odometry's frame, as FAST-LIO's /cloud_registered; the true pose."""

    def odometry(stamp: float, T: Pose) -> None:
        listener.transforms([Transform(stamp, "odom", "base_link", T)])
        listener.odometry(stamp, T)

    def cloud(event: Event, T_map_lidar: Pose) -> None:
        T_odom_lidar = geometry.inverse(T_MAP_ODOM) @ T_map_lidar
        listener.cloud(event.stamp, geometry.transform(T_odom_lidar, event.scan.points), frame)

    return listener.walk(plaza, count, odometry=odometry, cloud=cloud)


@pytest.mark.parametrize("parameters", [{}, {"base_to_lidar": [0.0] * 6}, {"odometry": "tf"}])
def test_clouds_in_the_odometrys_frame_are_named_and_give_no_pose(
    localizer: Localizer, plaza: Plaza, parameters: dict[str, Any]
) -> None:
    listener = Listener.of(localizer, **parameters)
    registered(plaza, listener, "odom")
    assert not listener.of_kind(PoseReply) and not listener.of_kind(MapToOdom)
    told = diagnose(listener.robot)
    assert told.message.startswith("clouds are in odom, the odometry's frame: use the driver's raw")
    assert told.values["refused"] == told.values["refused: world frame"] == "6"


def test_clouds_that_stand_still_under_a_sensors_name_end_the_localization(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer)
    registered(plaza, listener, LIDAR, count=8)
    told = diagnose(listener.robot)
    assert "clouds stand still while the odometry moves" in told.message
    assert listener.robot.T_map_odom is None and "refused: world frame" in told.values
    listener.clear()
    truth = listener.walk(plaza, 4, start_s=108.0, begin=(-12.0, 1.0))
    assert listener.off(truth) < 0.3


def test_a_mount_on_tf_counts_once_the_robot_drove_and_ends_the_localization_if_it_moves(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.of(localizer)
    lidar_base, joint = geometry.inverse(MOUNT), MOUNT

    def walk(count: int, start_s: float, begin: tuple[float, float]) -> Pose:
        for events, T_map_lidar in walked(plaza, count, start_s=start_s, begin=begin):
            for event in events:
                listener.transforms([Transform(event.stamp, "base_link", LIDAR, joint)])
                if event.scan is None:
                    listener.odometry(event.stamp, event.T_odom_base @ lidar_base)
                else:
                    listener.cloud(event.stamp, event.scan.points)
            truth = T_map_lidar @ lidar_base
        return truth

    walk(1, 100.0, (-14.0, 1.0))
    assert not listener.said
    assert "base_link -> os_sensor is on /tf, so it may move" in diagnose(listener.robot).message
    truth = walk(4, 101.0, (-12.0, 1.1))
    assert listener.off(truth) < 0.3
    assert diagnose(listener.robot).message == "localized"
    listener.clear()
    joint = MOUNT @ geometry.yaw_transform(0.0, (0.03, 0.0, 0.0))
    listener.transforms([Transform(104.5, "base_link", LIDAR, joint)])
    assert "base_link -> os_sensor moves" in diagnose(listener.robot).message
    assert listener.robot.T_map_odom is None
    listener.odometry(104.6, np.eye(4))
    assert not listener.said


def test_an_odometry_whose_z_axis_is_not_up_is_named(localizer: Localizer, plaza: Plaza) -> None:
    """Of a level base with z down and with a camera's axes; and with both frames z down."""
    for degrees in ((180.0, 0.0, 0.0), (90.0, 0.0, 90.0)):
        listener = Listener.mounted(localizer)
        turned = T_MAP_ODOM @ geometry.rigid(rotation(*degrees), np.zeros(3))
        listener.walk(plaza, 3, T_map_odom=turned)
        assert "the z axis of odom is not up" in diagnose(listener.robot).message
        assert not listener.of_kind(PoseReply)
    flip = geometry.rigid(rotation(180.0, 0.0, 0.0), np.zeros(3))
    listener = Listener.of(localizer)
    on_tf_static(listener.robot, flip @ MOUNT)
    flipped = {"odometry": lambda stamp, T: listener.odometry(stamp, T @ flip)}
    listener.walk(plaza, 6, T_map_odom=T_MAP_ODOM @ flip, **flipped)
    told = diagnose(listener.robot)
    assert not listener.of_kind(PoseReply)
    assert "in the odometry's axes the ground lies towards +z" in told.message


def test_clouds_without_points_are_no_scans_and_are_counted(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer)
    listener.walk(plaza, 3)
    scans = listener.robot.core.scans
    for k, points in enumerate((np.full((9, 3), np.nan), np.zeros((9, 3)), np.empty((0, 3)))):
        listener.odometry(102.5 + k, np.eye(4))
        listener.cloud(102.4 + k, points)
        assert "cloud refused" in diagnose(listener.robot).message
    told = diagnose(listener.robot)
    assert listener.robot.core.scans == scans and told.values["refused: no usable points"] == "3"
    assert float(told.values["cloud_age_s"]) < 60.0


@pytest.mark.parametrize(
    ("kind", "convert"),
    [
        ("f8", lambda turn, stamp: stamp + 0.1 * turn),
        ("f4", lambda turn, stamp: turn),
        ("f4", lambda turn, stamp: 1e8 * turn),
        ("u4", lambda turn, stamp: 1e8 * turn),
    ],
)
def test_point_times_of_any_unit_are_recognised(
    localizer: Localizer, plaza: Plaza, kind: str, convert: Any
) -> None:
    """A turn of 0.1 s as nanoseconds, seconds since 1970 and fractions; motion is undone alike."""
    listener = Listener.mounted(localizer)

    def timed(event: Event, T_map_lidar: Pose) -> None:
        turn = np.linspace(0.0, 1.0, len(event.scan.points))
        ahead = np.outer(3.0 * 0.1 * turn, T_map_lidar[0, :3])  # it drives along x of the map
        cloud = cloud_of(event.scan.points - ahead, ("time", kind, convert(turn, event.stamp)))
        listener.hear(listener.robot.on_cloud(cloud, event.stamp, LIDAR))

    truth = listener.walk(plaza, 25, cloud=timed, start_s=1.75e9, every_s=0.1, step=0.3)
    assert listener.off(truth) < 0.4, listener.robot.time_notes
    assert diagnose(listener.robot).message == "localized"


def test_livox_messages_are_read_from_their_bytes(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer)

    def livox(event: Event, _: Pose) -> None:
        listener.hear(listener.robot.on_livox(livox_of(event.scan.points, event.stamp)))

    truth = listener.walk(plaza, 6, cloud=livox, step=0.1)
    told = diagnose(listener.robot)
    assert told.message == "localized" and told.values["scans"] == "6"
    assert listener.off(truth) < 0.3
    assert not told.values.get("point times")  # in seconds after the stamp
    for data in (livox_of(plaza.points, 107.0)[:500], b"\0\1\0\0", b""):
        assert listener.robot.on_livox(data) == []
    told = diagnose(listener.robot)
    assert told.values["refused: unreadable"] == "3" and "cloud refused" in told.message


def test_points_on_the_robot_are_dropped_by_the_box_of_the_map(
    localizer: Localizer, plaza: Plaza
) -> None:
    local_cloud = localizer.config.local_cloud.model_copy(update={"body": BODY})
    config = localizer.config.model_copy(update={"local_cloud": local_cloud})
    masking = Localizer(localizer.prior_map, config)
    poses = []
    for used, change in ((localizer, beside), (masking, lambda points: with_mast(beside(points)))):
        listener = Listener.mounted(used, odometry="kiss-icp")
        for events, _ in walked(plaza, 5, step=0.5, every_s=0.1):
            for event in events:
                if event.scan is not None:
                    listener.cloud(event.stamp, change(event.scan.points))
        odometry, found = listener.of_kind(OdometryReply), listener.of_kind(PoseReply)
        poses.append([T.tobytes() for T in (each.T_map_base for each in found)])
        assert len(odometry) == 5 and poses[-1]
    assert poses[0] == poses[1]


def test_odometry_of_clouds_goes_on_after_the_clock_is_set_back(
    localizer: Localizer, plaza: Plaza
) -> None:
    """As by a bag that is played in a loop."""
    listener = Listener.mounted(localizer, odometry="kiss-icp")
    counts = []
    for _ in range(2):
        for events, _ in walked(plaza, 12, step=0.5, every_s=0.1):
            for event in events:
                if event.scan is not None:
                    listener.cloud(event.stamp, event.scan.points)
        counts.append(len(listener.of_kind(OdometryReply)))
    assert counts == [12, 24]


@pytest.mark.parametrize("first", ["odometry", "cloud"])
def test_a_robot_that_is_switched_off_and_on_keeps_no_pose_of_before(
    localizer: Localizer, plaza: Plaza, first: str
) -> None:
    """The clock and the odometry begin anew, whichever of both comes first."""
    listener = Listener.mounted(localizer, trigger="until_localized")
    truth, robot = listener.walk(plaza, 6), listener.robot
    points = [plaza.scan(truth @ MOUNT, posed=False, seed=k).points for k in range(4)]
    if first == "cloud":
        listener.cloud(10.0, points[0])
    for k, cloud in enumerate(points):
        listener.odometry(10.1 + 0.4 * k, np.eye(4))
        listener.cloud(10.2 + 0.4 * k, cloud)
        listener.odometry(10.3 + 0.4 * k, np.eye(4))
        assert robot.T_map_odom is None or off_m(robot.T_map_odom, truth) < 0.5
    assert robot.jumps == 1 and robot.T_map_odom is not None


@pytest.mark.parametrize("smooth", [False, True])
def test_a_jump_of_the_odometry_moves_map_to_odom_at_once(
    localizer: Localizer, plaza: Plaza, smooth: bool
) -> None:
    listener = Listener.mounted(localizer, smooth_tf=smooth)
    truth = listener.walk(plaza, 6)
    here = geometry.inverse(T_MAP_ODOM) @ truth
    moved = here @ geometry.yaw_transform(1.7, (0.0, 2.0, 0.0))
    listener.odometry(106.0, here)
    listener.clear()
    for k in range(1, 4):
        listener.odometry(106.0 + 0.02 * k, moved)
    last = listener.of_kind(MapToOdom)[-1].transform
    assert off_m(last.T_parent_child @ moved, truth) < 0.7


def test_clouds_that_are_repeated_or_late_lose_no_odometry(
    localizer: Localizer, plaza: Plaza
) -> None:
    listener = Listener.mounted(localizer, odometry="kiss-icp")
    clouds = [
        event for events, _ in walked(plaza, 8, step=0.5, every_s=0.1) for event in events
        if event.scan is not None
    ]  # fmt: skip
    for event in clouds:
        listener.cloud(event.stamp, event.scan.points)
    before = len(listener.of_kind(OdometryReply))
    for late_s in (0.0, 0.03):
        listener.cloud(clouds[-1].stamp - late_s, clouds[-1].scan.points)
    assert len(listener.of_kind(OdometryReply)) == before and listener.robot.jumps == 0


def test_a_robot_at_rest_keeps_its_pose_while_it_is_checked(
    localizer: Localizer, plaza: Plaza
) -> None:
    """After a way without queries, along which nothing supported the pose."""
    listener = Listener.mounted(localizer, trigger="until_localized")
    truth, robot = listener.walk(plaza, 4), listener.robot
    here = geometry.inverse(T_MAP_ODOM) @ truth
    stamp = 110.0
    for k in range(480):
        stamp += 0.4
        moved = geometry.yaw_transform(0.0, (0.5 * min(k % 80, 80 - k % 80), 0.0, 0.0))
        listener.odometry(stamp, here @ moved)
        if k % 5 == 0:
            scan = plaza.scan(truth @ moved @ MOUNT, posed=False, seed=k)
            listener.cloud(stamp - 0.1, scan.points)
    assert not robot.state.localized
    assert robot.trigger.resting and robot.T_map_odom is not None
    robot.request_update()
    assert robot.T_map_odom is not None
    listener.clear()
    for k in range(4):
        listener.odometry(stamp + 0.4 * (k + 1), here)
        listener.cloud(stamp + 0.4 * (k + 1), plaza.scan(truth @ MOUNT, posed=False, seed=k).points)
        listener.odometry(stamp + 0.4 * (k + 1) + 0.1, here)
    assert robot.trigger.resting and off_m(robot.T_map_odom @ here, truth) < 0.3


def test_a_click_is_used_for_some_seconds_by_any_clock() -> None:
    trigger = Trigger("periodic", 5.0)
    trigger.wake(Prior((0.0, 0.0), 10.0))
    assert trigger.near(1000.0) is not None and trigger.near(1004.0) is not None
    assert trigger.near(1.0) is None and trigger.near(1004.0) is None


# --- in the field ---------------------------------------------------------------------------------


def at(x: float, y: float, yaw: float = 0.0) -> Pose:
    """T_map_base on the plaza."""
    return geometry.yaw_transform(yaw, (x, y, 1.8)) @ geometry.inverse(MOUNT)


def by_odometry(T_map_base: Pose) -> Pose:
    return geometry.inverse(T_MAP_ODOM) @ T_map_base


def seen(plaza: Plaza, T_map_base: Pose, seed: int = 0) -> Any:
    return plaza.scan(T_map_base @ MOUNT, posed=False, seed=seed).points


def drive(
    listener: Listener, plaza: Plaza, way: list[Pose], odometry: list[Pose], stamp: float
) -> float:
    """Give odometry and a cloud at 10 Hz along T_map_base; return the stamp after it."""
    for k, (T_map_base, T_odom_base) in enumerate(zip(way, odometry, strict=True)):
        listener.odometry(stamp, T_odom_base)
        listener.cloud(stamp + 0.01, seen(plaza, T_map_base, k))
        stamp += 0.1
    return stamp


def test_odometry_that_restarts_after_an_outage_jumps(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, trigger="until_localized")
    before, after = ([at(x + 0.1 * k, 1) for k in range(n)] for x, n in ((-12, 40), (-8, 10)))
    T_odom_map = geometry.inverse(geometry.yaw_transform(0.0, (-42.0, 1.0, 0.0)))
    stamp = drive(listener, plaza, before, [T_odom_map @ T for T in before], 100.0)
    T_odom_map = geometry.inverse(before[-1])
    drive(listener, plaza, after, [T_odom_map @ T for T in after], stamp + 1.0)
    assert listener.robot.jumps == 1
    T_map_odom = listener.of_kind(MapToOdom)[-1].transform.T_parent_child
    assert off_m(T_map_odom @ T_odom_map @ after[-1], after[-1]) < 0.5


def test_a_robot_that_was_carried_is_found_by_what_it_sees_now(
    localizer: Localizer, plaza: Plaza
) -> None:
    rng = np.random.default_rng(1)
    for _ in range(6):
        before, after = (at(*rng.uniform(-12, 12, 2), rng.uniform(0, 6)) for _ in "ab")
        listener = Listener.mounted(
            localizer, odometry="none", mode="initialpose", trigger="until_localized"
        )
        for k in range(5):
            listener.cloud(100 + k * 0.1, seen(plaza, before, k))
        listener.clear()
        fixes = listener.robot.relocalize()
        for k in range(10):
            listener.cloud(200 + k * 0.1, seen(plaza, after, k))
            if listener.robot.fixes > fixes:
                break
        assert listener.robot.fixes > fixes and listener.off(after) < 0.5


def test_a_robot_whose_wheels_slip_is_localized_again(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, mode="tf")
    way = [at(-12 + 0.2 * k, 1) for k in range(40)]
    stamp = drive(listener, plaza, way, [by_odometry(T) for T in way], 100.0)
    slipped = [
        by_odometry(geometry.yaw_transform(0.0, (0.1 * k, 0.0, 0.0)) @ way[-1])
        for k in range(1, 41)
    ]
    stamp = drive(listener, plaza, 40 * way[-1:], slipped, stamp)
    listener.clear()
    fixes = listener.robot.relocalize()
    drive(listener, plaza, 30 * way[-1:], 30 * slipped[-1:], stamp)
    assert listener.robot.fixes > fixes and listener.of_kind(MapToOdom)
    assert diagnose(listener.robot).level is Level.OK


def test_a_map_that_was_away_for_a_moment_is_the_same(localizer: Localizer, tmp_path: Path) -> None:
    path, aside = tmp_path / "site.segmap", tmp_path / "aside"
    localizer.prior_map.save(path)
    maps = MapFile(str(path), 1)
    assert maps.newer() is not None
    path.rename(aside)
    assert maps.newer() is None and "no map" in maps.fault
    aside.rename(path)
    assert maps.newer() is None and maps.fault == ""
    path.write_bytes(b"damaged")
    assert maps.newer() is None and (fault := maps.fault)
    path.rename(aside)
    maps.newer()
    aside.rename(path)
    assert maps.newer() is None and maps.fault == fault


def test_a_url_is_tried_until_it_can_be_read(localizer: Localizer) -> None:
    pytest.importorskip("fsspec")
    url = "memory://segloc-robot/tiles"
    maps = MapFile(url, 1)
    for _ in range(2):
        assert maps.newer() is None and url in maps.fault
    cut_tiles(localizer.prior_map, url)
    assert maps.newer() is not None and maps.fault == ""
    assert maps.newer() is None


def test_a_pose_file_that_cannot_be_had_is_noted(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, pose_file=f"/tmp/{'x' * 300}")
    listener.walk(plaza, 3)
    assert listener.of_kind(PoseReply)


def test_poses_go_on_when_a_bag_is_looped(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, silent_s=15.0)
    for _ in range(3):
        listener.clear()
        for k in range(30):
            T, stamp = at(-12 + 0.2 * k, 1), 100.0 + 0.2 * k
            listener.odometry(stamp, by_odometry(T))
            listener.cloud(stamp + 0.01, seen(plaza, T, k))
        assert len(listener.of_kind(PoseReply)) > 20


def test_odometry_that_ends_at_rest_is_named(localizer: Localizer, plaza: Plaza) -> None:
    listener = Listener.mounted(localizer, trigger="until_localized")
    way = [at(-12 + 0.1 * k, 1) for k in range(30)]
    stamp = drive(listener, plaza, way, [by_odometry(T) for T in way], 100.0)
    assert diagnose(listener.robot).level is Level.OK
    for k in range(60):
        listener.cloud(stamp + 0.1 * k, seen(plaza, way[-1], k))
    found = diagnose(listener.robot)
    assert found.level is Level.WARN and "no odometry at the time of the scan" in found.message
    assert robot_state(listener.robot, True).map_to_odom is TfState.NONE
