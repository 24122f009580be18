"""The node as it is installed, in a process of its own, on a simulated drive: `make test-ros`."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from samples.plaza import Plaza, PlazaSequence, RingSequence
from samples.streams import T_MAP_ODOM, off_m, walked
from samples.usage import processor_s, resident_mb

from segloc import Config, Scan, SegmentMap, build_map, geometry
from segloc.map.georeference import KEY, Georeference
from segloc.tiles import cut_tiles
from segloc.types import Pose

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("tf2_msgs")

from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from samples.ros_peer import (  # noqa: E402
    LATCHED,
    MOUNT,
    Peer,
    running,
)
from segloc_ros.core.replies import PoseReply  # noqa: E402
from segloc_ros.messages import pose_in, pose_out, seconds, time_of, transform_in  # noqa: E402
from sensor_msgs.msg import NavSatFix  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402
from std_srvs.srv import Empty  # noqa: E402

pytestmark = pytest.mark.slow
INSTALLED = Path(os.environ.get("SEGLOC_ROS_INSTALL", "build/ros/ws/install")).resolve()
NODE = INSTALLED / "segloc_ros/lib/segloc_ros/segloc_node"
PARAMETERS = {
    "mode": "both", "trigger": "periodic", "points_reliable": True, "query_every_m": 4,
    "points_depth": 10,
}  # fmt: skip
WAIT_S = 60.0
SHIFT = geometry.yaw_transform(0.3, (100.0, 50.0, 0.0))


class Shifted(PlazaSequence):
    """The same walk in another map frame."""

    def __init__(self, plaza: Plaza) -> None:
        super().__init__(plaza)
        self.poses = SHIFT @ self.poses

    def scan(self, i: int) -> Scan:
        T = geometry.inverse(SHIFT) @ self.poses[i]
        scan = self._plaza.scan(T, posed=False, seed=i)
        scan.T_odom_sensor = self.poses[i]
        return scan


@pytest.fixture(scope="module")
def maps(plaza: Plaza, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, and one of the same place in another frame."""
    folder = tmp_path_factory.mktemp("maps")
    for name, walk in (("site", PlazaSequence(plaza)), ("shifted", Shifted(plaza))):
        build_map(walk, Config.preset("geo")).save(folder / f"{name}.segmap")
    return folder


@pytest.fixture(scope="module")
def peer(plaza: Plaza) -> Iterator[Peer]:
    rclpy.init()
    peer = Peer(plaza)
    yield peer
    peer.destroy_node()
    rclpy.shutdown()


@contextmanager
def at_work(
    peer: Peer, log: Path, prior_map: Path, *remaps: str, **parameters: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """The node with its map, told where the LiDAR is."""
    peer.clear()
    with running(NODE, log, *remaps, map=str(prior_map), **parameters) as node:
        peer.ready(odometry=parameters.get("odometry") != "kiss-icp")
        peer.tell_mount()
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        peer.spin(1.0)
        yield node


def localized(peer: Peer, truth: Pose, metres: float = 0.5) -> bool:
    """Whether the newest pose is of the newest cloud, and right."""
    peer.until(lambda: peer.heard["pose"] and peer.newest("pose")[0] >= peer.now - 1e-6, WAIT_S)
    return off_m(peer.newest("pose")[1], truth) < metres


def test_a_day_of_a_robot(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """Without a map, without tf, then a drive; what goes wrong after it, and that it recovers."""
    used, log = tmp_path / "used.segmap", tmp_path / "log"
    with running(NODE, log, map=str(used), **PARAMETERS) as node:
        peer.ready()
        peer.until(lambda: "no map" in peer.said, WAIT_S)
        shutil.copy(maps / "site.segmap", tmp_path / "part")
        (tmp_path / "part").replace(used)
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        assert peer.heard["map_cloud"][-1].width > 5000

        peer.walk(2)
        peer.until(
            lambda: peer.said.startswith("no transform base_link -> os_sensor in tf"), WAIT_S
        )
        assert not any(peer.heard[name] for name in ("pose", "initialpose", "tf", "matches"))
        peer.tell_mount()
        peer.spin(0.5)

        truth = peer.walk(4, begin=(-10.0, 1.2))
        assert localized(peer, truth), peer.said
        assert np.allclose(peer.map_to_odom()[:3, 3], T_MAP_ODOM[:3, 3], atol=6.0)
        assert len(peer.heard["initialpose"]) == 1 and peer.heard["matches"]
        peer.until(lambda: peer.said == "localized", WAIT_S)
        peer.until(lambda: int(peer.values["scans"]) >= 4, WAIT_S)
        assert float(peer.values["total_ms"]) > 0
        assert peer.values["points publishers"] == "1" and float(peer.values["cloud_age_s"]) < 60

        peer.send_cloud(peer.now + 0.1, np.full((100, 3), np.nan, np.float32))
        peer.until(lambda: peer.values.get("refused: no usable points") == "1", WAIT_S)
        peer.send_cloud(peer.now - 0.5, np.ones((100, 3), np.float32))  # late
        carried = geometry.yaw_transform(2.5, (3.0, -24.0, 0.0))
        truth = peer.walk(16, begin=(-2.0, 1.0), carried=carried, step=1.0)
        assert localized(peer, truth), peer.said
        peer.until(lambda: int(peer.values["dropped"]) >= 1, WAIT_S)

        reset = geometry.inverse(geometry.yaw_transform(-2.0, (9.0, 80.0, 1.0)))
        truth = peer.walk(12, T_map_odom=reset, step=1.0)
        assert localized(peer, truth), peer.said
        assert np.allclose(peer.map_to_odom(), reset, atol=0.5)

        shutil.copy(maps / "shifted.segmap", tmp_path / "part")
        (tmp_path / "part").replace(used)
        peer.heard["map_cloud"].clear()
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        truth = peer.walk(4, T_map_odom=reset, begin=(-2.0, 1.0), step=1.0)
        assert localized(peer, SHIFT @ truth), peer.said
        node.send_signal(signal.SIGKILL)
        node.wait(WAIT_S)

    peer.clear()
    with running(NODE, log, map=str(used), **PARAMETERS) as node:  # as by respawn
        peer.ready()
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        peer.spin(1.0)  # the mount is sent to it again, as all that is latched
        truth = peer.walk(4, T_map_odom=reset, begin=(2.0, 1.0), step=1.0)
        assert localized(peer, SHIFT @ truth), peer.said
        node.send_signal(signal.SIGINT)
        assert node.wait(WAIT_S) == 0
    assert b"Traceback" not in log.read_bytes()


def test_the_map_is_damaged_and_the_clock_jumps(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """The map in use stays, and diagnostics say why; stamps go back an hour, then ahead two."""
    used, site = tmp_path / "used.segmap", (maps / "site.segmap").read_bytes()

    def replace(data: bytes) -> None:
        (tmp_path / "part").write_bytes(data)
        (tmp_path / "part").replace(used)

    replace(site)
    with at_work(peer, tmp_path / "log", used, **PARAMETERS):
        truth = peer.walk(4, step=1.0)
        assert localized(peer, truth), peer.said
        replace(site[: len(site) // 2])
        peer.until(lambda: "the map in use stays: no map: " in peer.said, WAIT_S)
        assert peer.heard["diagnostics"][-1].status[0].level == b"\2"
        used.unlink()
        peer.until(lambda: "No such file" in peer.said, WAIT_S)
        truth = peer.walk(2, begin=(-10.0, 1.4), step=1.0)
        assert localized(peer, truth), peer.said
        for k, jump_s in enumerate((-3600.0, 7200.0)):
            peer.now += jump_s
            peer.clear()
            truth = peer.walk(5, begin=(5.0 * k - 8.0, 1.5), step=1.0)
            assert localized(peer, truth), peer.said
    assert "the map in use stays" in (tmp_path / "log").read_text()


def test_lidar_alone(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """No odometry comes in: the node computes it, publishes it, and is localized by it."""
    pytest.importorskip("kiss_icp")
    options = PARAMETERS | {"odometry": "kiss-icp", "query_every_m": 10}
    with at_work(peer, tmp_path / "log", maps / "site.segmap", **options):
        truth = peer.walk(40, odometry=False, step=0.5, every_s=0.1)
        assert localized(peer, truth), peer.said
        sent = [t for message in peer.heard["tf"] for t in message.transforms]
        assert {t.child_frame_id for t in sent} == {"odom", "base_link"}
        T_odom_base = pose_in(peer.heard["odom"][-1].pose.pose)
        assert off_m(peer.map_to_odom() @ T_odom_base, truth) < 0.5


def test_lidar_alone_for_500_m(peer: Peer, tmp_path: Path) -> None:
    """At 10 m/s by its stamps, once around: localized along 95 % of the way, nowhere falsely."""
    pytest.importorskip("kiss_icp")
    plaza, around_m = Plaza(3, objects=290, size=250.0), 500.0
    mapped, driven = (RingSequence(plaza, 80.0, around_m, *each) for each in ((2.0,), (1.0, 0.7)))
    build_map(mapped, Config.preset("geo")).save(tmp_path / "ring.segmap")
    options = PARAMETERS | {"odometry": "kiss-icp", "query_every_m": 10, "mode": "tf"}
    with at_work(peer, tmp_path / "log", tmp_path / "ring.segmap", **options):
        peer.heard["diagnostics"].clear()
        truths = peer.drive(driven)
        assert localized(peer, truths[peer.now]), peer.said
    told = {round(seconds(m.header.stamp), 6): pose_in(m.pose.pose) for m in peer.heard["pose"]}
    assert max(off_m(T, truths[stamp]) for stamp, T in told.items()) < 1.0
    assert len(told) > 0.95 * len(truths)
    states = [message.status[0].message for message in peer.heard["diagnostics"]]
    states = states[states.index("localized") :]
    assert states.count("localized") > 0.95 * len(states)


def test_a_pose_over_a_power_cycle(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """Boots where it was switched off, elsewhere, and with another map."""
    kept = tmp_path / "pose.json"
    options = PARAMETERS | {"pose_file": str(kept), "click_s": 2.0, "click_radius_m": 5.0}
    boots = [
        ("site", np.eye(4), "no file"),
        ("site", np.eye(4), "kept pose confirmed"),
        ("site", geometry.yaw_transform(2.5, (3.0, -24.0, 0.0)), "not confirmed within 2 s"),
        ("shifted", np.eye(4), "of another map"),
    ]
    for k, (name, carried, said) in enumerate(boots):
        log = tmp_path / f"log {k}"
        with at_work(peer, log, maps / f"{name}.segmap", **options) as node:
            truth = peer.walk(7, begin=(3.0 * k - 14.0, 1.0), step=0.5, carried=carried)
            truth = SHIFT @ truth if name == "shifted" else truth
            assert localized(peer, truth), peer.said
            offs = [off_m(pose_in(m.pose.pose), truth) for m in peer.heard["pose"]]
            assert max(offs) < 4.0, (k, offs)
            node.send_signal(signal.SIGINT)
            assert node.wait(WAIT_S) == 0
        assert said in log.read_text()
        T = np.array(json.loads(kept.read_text())["T_map_base"])
        assert off_m(T, truth) < 0.5


def test_maps_are_replaced_while_it_drives(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """By the service: tiles, a file that is none, and a map of another frame; by the parameter."""
    from rcl_interfaces.srv import SetParameters

    cut_tiles(SegmentMap.load(maps / "site.segmap"), tmp_path / "tiles", size_m=50.0)
    log, site = tmp_path / "log", maps / "site.segmap"
    with at_work(peer, log, site, **PARAMETERS):
        peer.walk(2, step=1.0)
        assert peer.load_map(tmp_path / "tiles", np.eye(4)).success
        truth = peer.walk(4, begin=(-11.0, 1.2), step=1.0)
        assert localized(peer, truth), peer.said
        refused = peer.load_map(tmp_path / "nothing.segmap")
        assert not refused.success and "nothing.segmap" in refused.message
        truth = peer.walk(2, begin=(-7.0, 1.4), step=1.0)
        assert localized(peer, truth), peer.said
        assert peer.load_map(maps / "shifted.segmap", SHIFT).success
        truth = peer.walk(4, begin=(-5.0, 1.5), step=1.0)
        assert localized(peer, SHIFT @ truth), peer.said
        peer.heard["map_cloud"].clear()
        value = Parameter("map", value=str(site)).to_parameter_msg()
        client = peer.create_client(SetParameters, "/segloc/set_parameters")
        peer.until(client.service_is_ready, WAIT_S)
        peer.ask(client, SetParameters.Request(parameters=[value]), again_s=10.0)
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        truth = peer.walk(4, begin=(-1.0, 1.6), step=1.0)
        assert localized(peer, truth), peer.said
    assert b"Traceback" not in log.read_bytes()


def test_two_lidars_a_wrong_fix_and_a_smooth_transform(
    peer: Peer, maps: Path, tmp_path: Path
) -> None:
    """GNSS has no fix, then one that is 30 m off, sure of 1 m; then the odometry slips by 0.8 m."""
    pytest.importorskip("pyproj")
    site = SegmentMap.load(maps / "site.segmap")
    here = Georeference(25832, (691_600.25, 5_336_000.5, 520.0))
    site.metadata[KEY] = here.to_text()
    site.save(tmp_path / "site.segmap")
    longitude, latitude, _ = here.on_globe(np.array([[16.0, 4.0, 0.0]]))[0].tolist()
    fix = NavSatFix(longitude=longitude, latitude=latitude, position_covariance_type=2)
    fix.status.status = fix.status.STATUS_FIX
    fix.position_covariance = np.eye(3).ravel().tolist()
    options = PARAMETERS | {
        "mode": "tf", "more_points_topics": "[rear]", "fix_topic": "fix", "smooth_tf": "true",
        "smooth_tf_mps": 0.1, "smooth_tf_dps": 1.0,
    }  # fmt: skip
    with at_work(peer, tmp_path / "log", tmp_path / "site.segmap", **options):
        peer.until(peer.fix.get_subscription_count, WAIT_S)
        peer.fix.publish(NavSatFix())
        peer.walk(2, rear=True, step=0.0)
        peer.fix.publish(fix)
        peer.spin(1.0)
        peer.relocalize()
        truth = peer.walk(14, rear=True, step=0.5)
        assert localized(peer, truth), peer.said
        assert off_m(pose_in(peer.heard["candidates"][-1].poses[0]), truth) < 8.0
        half = len(peer.plaza.scan(truth @ MOUNT, posed=False).points) / 2
        assert float(peer.values["points"]) > 1.5 * half
        peer.heard["tf"].clear()
        slipped = T_MAP_ODOM @ geometry.yaw_transform(0.0, (0.8, 0.0, 0.0))
        peer.walk(16, rear=True, step=0.5, begin=(-7.0, 2.4), T_map_odom=slipped)
        sent = [transform_in(t) for message in peer.heard["tf"] for t in message.transforms]
        base = (geometry.inverse(slipped) @ truth)[:3, 3]
        at = [(t.stamp, geometry.transform(t.T_parent_child, base[None])[0]) for t in sent]
        assert len(at) > 10 and 0.2 < np.linalg.norm(at[-1][1] - at[0][1]) < 1.0
        for (begin, a), (end, b) in pairwise(at):
            assert np.linalg.norm(b - a) < 0.1 * (end - begin) + 0.05


def test_a_lift(peer: Peer, plaza: Plaza, tmp_path: Path) -> None:
    """From storey 0 to 2, which its odometry does not notice: by load_map, and in one map."""
    up = geometry.yaw_transform(0.0, (0.0, 0.0, 8.0))
    walk = PlazaSequence(plaza).poses
    storeys, scans = [plaza, Plaza(5), Plaza(6)], []
    for k, storey in enumerate(storeys):
        poses = np.linalg.matrix_power(up, k) @ walk
        storey.points = storey.points + [0.0, 0.0, 8.0 * k]
        scans.append([storey.scan(T, seed=i) for i, T in enumerate(poses)])
        build_map(scans[k], Config.preset("geo")).save(tmp_path / f"{k}.segmap")
    build_map([scan for each in scans for scan in each], Config.preset("geo")).save(
        tmp_path / "all.segmap"
    )
    lifted = up @ up
    for name in ("0", "all"):
        with at_work(peer, tmp_path / "log", tmp_path / f"{name}.segmap", **PARAMETERS):
            peer.plaza = storeys[0]
            truth = peer.walk(4, step=1.0)
            assert localized(peer, truth), peer.said
            if name == "0":
                assert peer.load_map(tmp_path / "2.segmap", np.eye(4)).success
            peer.plaza = storeys[2]
            peer.clear()
            count = 6 if name == "0" else 20
            truth = peer.walk(count, begin=(-10.0, 1.4), step=1.0, carried=lifted)
            peer.plaza = storeys[0]
            assert localized(peer, truth), peer.said


def test_a_click_and_a_call(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """At rest until somebody asks; then near the click, or anywhere, and back to rest."""
    quiet = PARAMETERS | {
        "mode": "initialpose", "trigger": "service", "service_timeout_s": 60.0,
        "click_topic": "~/click",  # the peer listens to initialpose
    }  # fmt: skip
    with at_work(peer, tmp_path / "log", maps / "site.segmap", **quiet):
        peer.walk(2)
        peer.until(lambda: peer.said == "at rest: call ~/relocalize", WAIT_S)
        assert not peer.heard["initialpose"]
        near = geometry.yaw_transform(0.0, (-9.0, 3.0, 0.0))
        peer.click.publish(pose_out(PoseReply(0.0, "map", near, np.eye(6))))
        peer.spin(0.5)
        truth = peer.walk(2, begin=(-10.0, 1.2), step=0.0)
        peer.until(lambda: peer.heard["initialpose"], WAIT_S)
        stamp, T = peer.newest("initialpose")
        assert stamp >= peer.now - 1.0 - 1e-6 and off_m(T, truth) < 0.5
        covariance = peer.heard["initialpose"][-1].pose.covariance
        assert covariance[0] > 0.06 and covariance[35] > 0.007
        called = peer.relocalize()
        peer.spin(0.5)
        peer.walk(2, begin=(-10.0, 1.2), step=0.0)
        peer.until(called.done, WAIT_S)
        assert called.result().success and called.result().message == "localized, at rest"
        assert len(peer.heard["initialpose"]) == 2 and not peer.heard["tf"]
        # A tracker that was not there when the robot was found is told when it comes.
        peer.turn_away("initialpose")
        called = peer.relocalize()
        peer.spin(0.5)
        peer.walk(2, begin=(-10.0, 1.2), step=0.0)
        peer.until(called.done, WAIT_S)
        peer.clear()
        peer.listen("initialpose")
        peer.until(lambda: peer.heard["initialpose"], WAIT_S)


def test_amcl_is_told_by_its_topic_and_its_service(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """A stand-in for AMCL, with the parameters for Nav2: once each, and an echo is no click."""
    kind = pytest.importorskip("nav2_msgs.srv").SetInitialPose
    called: list[Any] = []

    def set_initial_pose(request: Any, response: Any) -> Any:
        called.append(request.pose)
        return response

    amcl = peer.create_service(kind, "/set_initial_pose", set_initial_pose)
    file = INSTALLED / "segloc_ros/share/segloc_ros/config/nav2.yaml"
    options = yaml.safe_load(file.read_text())["/**"]["ros__parameters"] | {
        "set_initial_pose_service": "set_initial_pose", "points_reliable": True,
    }  # fmt: skip
    with at_work(peer, tmp_path / "log", maps / "site.segmap", **options):
        truth = peer.walk(3, step=0.0)
        peer.until(lambda: called and peer.said == "localized, at rest", WAIT_S)
        told = [*called, *peer.heard["initialpose"]]
        assert len(called) == len(peer.heard["initialpose"]) == 1
        for message in told:
            assert message.header.frame_id == "map"
            assert off_m(pose_in(message.pose.pose), truth) < 0.5
    peer.destroy_service(amcl)


def test_it_takes_amcls_place(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """AMCL's names by remaps; a listener that comes late gets the pose and the state."""
    kind = pytest.importorskip("nav2_msgs.srv").SetInitialPose
    state_type = pytest.importorskip("segloc_msgs.msg").State
    services = "reinitialize_global_localization", "set_initial_pose", "request_nomotion_update"
    names = {"pose": "amcl_pose"} | {name: name for name in services}
    remaps = [part for own, amcls in names.items() for part in ("-r", f"~/{own}:={amcls}")]
    poses: list[Any] = []
    states: list[Any] = []
    flags: list[Any] = []
    options = PARAMETERS | {"mode": "tf", "tf_when_lost": "keep"}
    with at_work(peer, tmp_path / "log", maps / "site.segmap", *remaps, **options):
        truth = peer.walk(3, step=0.0)
        peer.until(lambda: peer.said == "localized", WAIT_S)
        ends = [
            peer.create_subscription(
                PoseWithCovarianceStamped, "/amcl_pose", poses.append, LATCHED
            ),
            peer.create_subscription(state_type, "/segloc/state", states.append, LATCHED),
            peer.create_subscription(Bool, "/segloc/localized", flags.append, LATCHED),
        ]
        peer.until(lambda: poses and states and flags, WAIT_S)
        assert off_m(pose_in(poses[-1].pose.pose), truth) < 0.5
        assert states[-1].status == state_type.LOCALIZED and flags[-1].data
        assert states[-1].map_to_odom == state_type.TF_CURRENT and states[-1].confidence > 0.9
        assert states[-1].map_url.endswith("site.segmap") and states[-1].reason == ""

        reinitialize = peer.create_client(Empty, "/reinitialize_global_localization")
        peer.until(reinitialize.service_is_ready, WAIT_S)
        peer.ask(reinitialize, Empty.Request(), again_s=10.0)
        peer.until(lambda: states[-1].status == state_type.LOST and not flags[-1].data, WAIT_S)
        assert states[-1].map_to_odom == state_type.TF_KEPT
        peer.walk(2, step=0.0)
        peer.until(lambda: flags[-1].data, WAIT_S)

        set_pose = peer.create_client(kind, "/set_initial_pose")
        peer.until(set_pose.service_is_ready, WAIT_S)
        near = geometry.yaw_transform(0.0, (-12.0, 2.0, 0.0))
        request = kind.Request(pose=pose_out(PoseReply(0.0, "map", near, np.eye(6))))
        peer.ask(set_pose, request, again_s=10.0)
        peer.until(lambda: not flags[-1].data, WAIT_S)
        peer.walk(2, step=0.0)
        peer.until(lambda: flags[-1].data, WAIT_S)

        update = peer.create_client(Empty, "/request_nomotion_update")
        peer.until(update.service_is_ready, WAIT_S)
        peer.heard["candidates"].clear()
        peer.ask(update, Empty.Request(), again_s=10.0)
        peer.walk(1, step=0.0)
        peer.until(lambda: peer.heard["candidates"], WAIT_S)
        for end in ends:
            peer.destroy_subscription(end)


def test_livox_messages_are_taken(
    peer: Peer, maps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node subscribes with the type that its driver publishes, whichever comes first."""
    livox = pytest.importorskip("livox_ros_driver2.msg")

    def send_cloud(stamp: float, points: Any) -> None:
        message = livox.CustomMsg(point_num=len(points))
        message.header.stamp, message.header.frame_id = time_of(stamp), "os_sensor"
        message.points = [livox.CustomPoint(x=x, y=y, z=z) for x, y, z in points.tolist()]
        publisher.publish(message)

    peer.clear()
    options = PARAMETERS | {"points_topic": "livox/lidar"}
    with running(NODE, tmp_path / "log", map=str(maps / "site.segmap"), **options):
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        publisher = peer.create_publisher(livox.CustomMsg, "/livox/lidar", 5)
        monkeypatch.setattr(peer, "send_cloud", send_cloud)
        peer.until(publisher.get_subscription_count, WAIT_S)
        peer.tell_mount()
        peer.spin(1.0)
        truth = peer.walk(4, step=0.5)
        assert localized(peer, truth), peer.said
        peer.destroy_publisher(publisher)


def test_the_lifecycle_is_that_of_ros(peer: Peer, maps: Path, tmp_path: Path) -> None:
    """With autostart false somebody else configures and activates it, as Nav2's manager does."""
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    beats: list[Any] = []
    status = pytest.importorskip("bond.msg").Status
    peer.create_subscription(status, "/bond", beats.append, 10)
    change = peer.create_client(ChangeState, "/segloc/change_state")
    get = peer.create_client(GetState, "/segloc/get_state")
    options = PARAMETERS | {"autostart": "false", "mode": "tf"}

    def to(transition: int) -> bool:
        return peer.ask(change, ChangeState.Request(transition=Transition(id=transition))).success

    with running(NODE, tmp_path / "log", map=str(maps / "site.segmap"), **options):
        peer.until(lambda: get.service_is_ready() and change.service_is_ready(), WAIT_S)
        now = peer.ask(get, GetState.Request(), again_s=2.0).current_state
        assert now.id == State.PRIMARY_STATE_UNCONFIGURED
        peer.clear()
        assert to(Transition.TRANSITION_CONFIGURE)
        peer.until(lambda: peer.said == "inactive", WAIT_S)
        assert to(Transition.TRANSITION_ACTIVATE)
        peer.tell_mount()
        peer.ready()
        truth = peer.walk(3)
        assert localized(peer, truth), peer.said
        assert {(beat.id, beat.active) for beat in beats} == {("segloc", True)}
        assert to(Transition.TRANSITION_DEACTIVATE)
        peer.until(lambda: not beats[-1].active, WAIT_S)
        peer.clear()
        peer.walk(2, begin=(-8.0, 1.3))
        assert not peer.heard["pose"] and not peer.heard["tf"]
        assert to(Transition.TRANSITION_ACTIVATE)
        called = peer.relocalize()  # and nothing comes
        peer.spin(0.5)
        assert to(Transition.TRANSITION_DEACTIVATE) and to(Transition.TRANSITION_CLEANUP)
        peer.until(called.done, WAIT_S)
        assert not called.result().success
        assert to(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)


def test_autoware_is_answered(peer: Peer, maps: Path, tmp_path: Path) -> None:
    kind = pytest.importorskip("autoware_internal_localization_msgs.srv").PoseWithCovarianceStamped
    peer.clear()
    client = peer.create_client(kind, "/ndt_align_srv")
    options = PARAMETERS | {
        "mode": "initialpose", "trigger": "service", "odometry": "none", "click_s": 3.0,
        "initialpose_topic": "~/initialpose",
    }  # fmt: skip
    align = INSTALLED / "segloc_autoware/lib/segloc_autoware/align_node"
    with running(align, tmp_path / "log", map=str(maps / "site.segmap"), **options):
        peer.until(client.service_is_ready, WAIT_S)
        peer.tell_mount()
        peer.until(lambda: peer.heard["map_cloud"], WAIT_S)
        peer.spin(1.0)  # until the service has discovered its client, too
        for x, expected in ((-9.0, True), (300.0, False)):
            near = geometry.yaw_transform(0.0, (x, 3.0, 0.0))
            request = kind.Request()
            request.pose_with_covariance = pose_out(PoseReply(0.0, "map", near, np.eye(6)))
            called = client.call_async(request)
            until = time.monotonic() + WAIT_S
            while not called.done() and time.monotonic() < until:
                truth = peer.walk(1, begin=(-12.0, 1.1), step=0.0)
            response = called.result()
            assert (response.success, response.reliable) == (expected, expected)
            if expected:
                assert off_m(pose_in(response.pose_with_covariance.pose.pose), truth) < 0.5


@pytest.mark.parametrize("trigger", ["periodic", "until_localized"])
def test_what_it_costs(peer: Peer, maps: Path, plaza: Plaza, tmp_path: Path, trigger: str) -> None:
    """Processor time of a cloud, queries included: `-k costs -s` prints it."""
    events = [e for events, _ in walked(plaza, 25, begin=(-14.0, 1.0), step=1.0) for e in events]
    size = np.mean([12e-6 * len(e.scan.points) for e in events if e.scan is not None])
    options = PARAMETERS | {"trigger": trigger, "query_every_m": 10}
    with at_work(peer, tmp_path / "log", maps / "site.segmap", **options) as node:
        begun = processor_s(node.pid)
        for event in events:
            stamp = peer.now + 10.0 + (event.stamp - 100.0)
            if event.scan is None:
                peer.send_odometry(stamp, event.T_odom_base @ geometry.inverse(MOUNT))
            else:
                peer.send_cloud(stamp, event.scan.points)
            peer.spin(0.07)
        peer.spin(1.0)
        taken, scans = processor_s(node.pid) - begun, int(peer.values["scans"])
        ms, resident = 1e3 * taken / max(1, scans), resident_mb(node.pid)
    peer.now = stamp
    print(f"\n{trigger}: {scans} clouds of {size:.1f} MB, {ms:.0f} ms of a core each, ", end="")
    print(f"{peer.values['intake_ms']} ms to take one in, {resident:.0f} MB resident")
    assert scans >= 5 and ms < 1000


def test_a_peer_that_shares_nothing_with_it_is_understood(maps: Path, tmp_path: Path) -> None:
    """Cyclone DDS, and messages written by other code, in both directions."""
    pytest.importorskip("cyclonedds")
    options = PARAMETERS | {"mode": "initialpose", "trigger": "until_localized"}
    with running(NODE, tmp_path / "log", map=str(maps / "site.segmap"), **options):
        script = Path(__file__).with_name("cyclone.py")
        done = subprocess.run(
            [sys.executable, script, "6"],
            capture_output=True,
            text=True,
            timeout=200,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        )
    assert done.returncode == 0, done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(told) == 1 and told[0]["frame"] == "map"
    assert np.allclose(told[0]["at"], told[0]["truth"], atol=0.3)
    covariance = np.reshape(told[0]["covariance"], (6, 6))
    assert np.allclose(covariance, covariance.T) and covariance[0, 0] > 0.06
