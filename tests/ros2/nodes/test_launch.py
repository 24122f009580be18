"""The launch files by the real ``launch`` and ``launch_ros``, and how nodes start and end."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("tf2_msgs")

from samples.ros_peer import running

pytestmark = pytest.mark.slow
INSTALLED = Path(os.environ.get("SEGLOC_ROS_INSTALL", "build/ros/ws/install")).resolve()
NODE = INSTALLED / "segloc_ros/lib/segloc_ros/segloc_node"
ALIGN = INSTALLED / "segloc_autoware/lib/segloc_autoware/align_node"
NAV2 = Path(os.environ.get("SEGLOC_ROS_LAUNCH", "")) / "nav2"
WAIT_S = 90.0
CTRL_C, DOCKER_STOP = signal.SIGINT, signal.SIGTERM
ROS2_LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
arguments = [each.split(":=", 1) for each in sys.argv[2:]]
source = PythonLaunchDescriptionSource(sys.argv[1])
service = LaunchService(noninteractive=True)
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
"""
STAND_IN = f"""#!{sys.executable} -SI
import json, os, signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])
files = [open(file).read() for flag, file in zip(sys.argv, sys.argv[1:]) if flag == "--params-file"]
names = [rule[8:] for rule in sys.argv if rule.startswith("__node:=")]
names.append(os.path.basename(sys.argv[0]))
name = f"{{os.environ['RECORDS']}}/{{names[0]}}.{{os.getpid()}}"
with open(name, "w") as out:
    json.dump([sys.argv[1:], files], out)
os.rename(name, name + ".json")
signal.sigwait([signal.SIGINT, signal.SIGTERM])
"""
needs_launch = pytest.mark.skipif(
    "SEGLOC_ROS_LAUNCH" not in os.environ, reason="no sources of ROS 2 launch beside the clone"
)


class Started:
    """What a stand-in was started with."""

    def __init__(self, file: Path) -> None:
        self.arguments, files = json.loads(file.read_text())
        flagged = list(zip(self.arguments, self.arguments[1:], strict=False))
        self.remaps = dict(rule.split(":=") for flag, rule in flagged if flag == "-r")
        set_alone = [rule.split(":=") for flag, rule in flagged if flag == "-p"]
        self.parameters = {name: yaml.safe_load(value) for name, value in set_alone}
        for text in files:
            plain = text.replace("!!python/tuple", "")  # which ROS does not look at
            for values in yaml.safe_load(plain).values():
                self.parameters |= values.get("ros__parameters", {})

    @property
    def namespace(self) -> str:
        return self.remaps.get("__ns", "/").strip("/")


class Launched:
    """A launch file that runs, as by ``ros2 launch`` in a terminal of its own."""

    def __init__(self, process: subprocess.Popen[bytes], folder: Path) -> None:
        self.process, self._folder = process, folder

    @property
    def output(self) -> str:
        return (self._folder / "output").read_text()

    def started(self, name: str) -> Started:
        """The stand-in of that node or executable, once all are there."""
        self.until(lambda: any(self._folder.glob(f"{name}.*.json")), f"{name} is not started")
        self.until(
            lambda: self.output.count("process started") == len(list(self._folder.glob("*.json"))),
            "not all have started",
        )
        return Started(next(self._folder.glob(f"{name}.*.json")))

    def until(self, true: Callable[[], Any], fault: str) -> None:
        end = time.monotonic() + WAIT_S
        while not true():
            assert time.monotonic() < end and self.process.poll() is None, fault + self.output
            time.sleep(0.05)

    def members(self) -> list[int]:
        """Processes of its session that live."""
        pids = [int(file.name) for file in Path("/proc").iterdir() if file.name.isdigit()]
        return [pid for pid in pids if session(pid) == self.process.pid]

    def ended(self, status: int = 0) -> None:
        """Wait for its end: the exit status, nothing left, no traceback."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(WAIT_S)
        assert self.process.poll() == status, self.output
        end = time.monotonic() + 10.0
        while self.members():
            assert time.monotonic() < end, "processes are left"
            time.sleep(0.05)
        assert "Traceback" not in self.output, self.output


def session(pid: int) -> int | None:
    """Session of a process; None if there is none, or it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] == "Z" else int(fields[3])


def blocks_signals(pid: int) -> bool:
    """Whether a node waits for its signals, as it does before it imports anything."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
    return bool(int(re.findall(r"SigBlk:\s+(\w+)", text)[0], 16) >> (signal.SIGTERM - 1) & 1)


@pytest.fixture
def stand_ins(tmp_path: Path) -> Path:
    """A prefix with stand-ins for Nav2, RViz, and the nodes of segloc."""
    prefix = tmp_path / "prefix"
    shutil.copytree(NAV2 / "nav2_bringup", prefix / "share" / "nav2_bringup")
    for package in ("segloc_ros", "segloc_autoware"):
        (prefix / "share" / package).symlink_to(INSTALLED / package / "share" / package)
    texts = [file.read_text() for file in (prefix / "share").glob("*/launch/*.py")]
    pattern = r"package=[\"'](\w+)[\"'],\s+executable=[\"'](\w+)[\"']"
    found = {pair for text in texts for pair in re.findall(pattern, text)}
    found |= {("segloc_ros", "segloc_node"), ("segloc_autoware", "align_node")}
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for package, executable in (*found, ("nav2_bringup", "nothing")):
        file = prefix / "lib" / package / executable
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(STAND_IN)
        file.chmod(0o755)
        (index / package).touch()
    return prefix


@contextmanager
def launched(
    folder: Path, name: str, *arguments: str, prefix: Path | None = None
) -> Iterator[Launched]:
    package = "segloc_autoware" if name == "align" else "segloc_ros"
    file = INSTALLED / package / "share" / package / "launch" / f"{name}.launch.py"
    environment = os.environ | {"RECORDS": str(folder), "ROS_LOG_DIR": str(folder)}
    if prefix is not None:
        environment["AMENT_PREFIX_PATH"] = f"{prefix}:{os.environ['AMENT_PREFIX_PATH']}"
        environment["PYTHONPATH"] = f"{NAV2 / 'nav2_common'}:{os.environ.get('PYTHONPATH', '')}"
    with (folder / "output").open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", ROS2_LAUNCH, file, *arguments],
            stdout=out, stderr=out, env=environment, start_new_session=True,
        )  # fmt: skip
    launch = Launched(process, folder)
    try:
        yield launch
    finally:
        for pid in launch.members():
            os.kill(pid, signal.SIGKILL)
        process.wait(WAIT_S)


@needs_launch
@pytest.mark.parametrize("namespace", ["", "robot1"])
@pytest.mark.parametrize("name", ["segloc", "lidar_alone", "nav2", "nav2_without_amcl"])
def test_arguments_arrive(name: str, namespace: str, stand_ins: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("/**:\n  ros__parameters: {query_every_m: 7.0, tf_rate_hz: 5}\n")
    given = [
        "map:=/maps/site.segmap", "points:=/ouster/points", "odom:=/wheels", "rviz:=true",
        f"namespace:={namespace}", f"params_file:={own}", "use_sim_time:=true",
        "base_to_lidar:=[1, 0, 1.5, 0, 0, 0]", "grid:=/maps/site.yaml", "use_composition:=False",
    ]  # fmt: skip
    with launched(tmp_path, name, *given, prefix=stand_ins) as launch:
        node, rviz = launch.started("segloc"), launch.started("rviz2")
        tf = {"/tf": "tf", "/tf_static": "tf_static"}
        for each in (node, rviz):
            assert each.namespace == namespace
            assert each.remaps.items() >= {"points": "/ouster/points", **tf}.items()
            assert each.parameters["use_sim_time"] is True
        assert node.remaps["odom"] == "/wheels" and node.remaps["__node"] == "segloc"
        expected = {"map": "/maps/site.segmap", "query_every_m": 7.0, "tf_rate_hz": 5}
        expected |= {"base_to_lidar": [1.0, 0.0, 1.5, 0.0, 0.0, 0.0]}
        modes = {"lidar_alone": ("tf", "kiss-icp"), "nav2_without_amcl": ("tf", "topic")}
        mode, odometry = modes.get(name, ("initialpose", "topic"))
        assert node.parameters.items() >= (expected | {"mode": mode}).items()
        assert node.parameters["odometry"] == odometry
        with_amcl = name == "nav2"
        assert node.parameters["click_topic"] == "initialpose"
        amcl_names = {"pose": "amcl_pose"} | {
            service: service
            for service in (
                "reinitialize_global_localization", "request_nomotion_update", "set_initial_pose"
            )
        }  # fmt: skip
        for each, prefix in ((node, "~/"), (rviz, "segloc/")):
            renamed = {key: each.remaps.get(prefix + key) for key in amcl_names}
            expected = amcl_names if name == "nav2_without_amcl" else dict.fromkeys(amcl_names)
            assert renamed == expected
        if name.startswith("nav2"):
            for server in ("map_server", "planner_server", *(["amcl"] * with_amcl)):
                nav2 = launch.started(server)
                assert nav2.namespace == namespace, server
                assert nav2.parameters["use_sim_time"] is True
            assert launch.started("map_server").parameters["yaml_filename"] == "/maps/site.yaml"
            assert with_amcl or not list(tmp_path.glob("amcl.*"))
        os.killpg(launch.process.pid, CTRL_C)
        launch.ended()


@needs_launch
def test_autoware_gets_its_arguments(stand_ins: Path, tmp_path: Path) -> None:
    given = ["map:=/maps/site.segmap", "points:=/top", "use_sim_time:=true", "odometry:=topic"]
    with launched(tmp_path, "align", *given, prefix=stand_ins) as launch:
        node = launch.started("segloc")
        service = "/localization/pose_estimator/ndt_align_srv"
        assert node.remaps.items() >= {"points": "/top", "ndt_align_srv": service}.items()
        expected = {"map": "/maps/site.segmap", "use_sim_time": True, "odometry": "topic"}
        assert node.parameters.items() >= expected.items()
        os.killpg(launch.process.pid, CTRL_C)
        launch.ended()


@needs_launch
@pytest.mark.parametrize(
    ("argument", "status"),
    [("mode:=odom", 0), ("params_file:=/nowhere.yaml", 1), ("base_to_lidar:=[1, 0]x", 1)],
)
def test_a_wrong_argument_ends_the_launch(tmp_path: Path, argument: str, status: int) -> None:
    with launched(tmp_path, "segloc", argument) as launch:
        launch.ended(status)
        assert launch.output.count("process started") <= 1
        name = argument.partition(":=")[0]
        lines = [line for line in launch.output.splitlines() if name in line and "cmd" not in line]
        assert len(lines) == 1, launch.output


@needs_launch
def test_a_crash_is_started_again(stand_ins: Path, tmp_path: Path) -> None:
    with launched(tmp_path, "segloc", prefix=stand_ins) as launch:
        launch.started("segloc")
        (record,) = tmp_path.glob("segloc.*.json")
        os.kill(int(record.name.split(".")[1]), signal.SIGKILL)
        launch.until(lambda: len(list(tmp_path.glob("segloc.*.json"))) == 2, "no respawn")
        launch.until(lambda: launch.output.count("process started with pid") == 2, "not told")


@needs_launch
@pytest.mark.parametrize("seconds", [0.0, 0.7, 4.0])
def test_ctrl_c_while_it_starts(tmp_path: Path, seconds: float) -> None:
    with launched(tmp_path, "segloc", "map:=/nowhere.segmap") as launch:
        launch.until(
            lambda: any(map(blocks_signals, set(launch.members()) - {launch.process.pid})),
            "no node",
        )
        time.sleep(seconds)
        os.killpg(launch.process.pid, CTRL_C)
        launch.ended()
        assert "has died" not in launch.output, launch.output


@needs_launch
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_no_node_outlives_its_launch(tmp_path: Path, end: signal.Signals) -> None:
    """``ros2 launch`` leaves its processes behind when it is terminated."""
    with launched(tmp_path, "segloc", "map:=/nowhere.segmap") as launch:
        launch.until(lambda: "no map" in launch.output, "no node")
        launch.process.send_signal(end)
        launch.ended(launch.process.wait(WAIT_S))


@pytest.mark.parametrize("end", [CTRL_C, DOCKER_STOP])
@pytest.mark.parametrize(
    ("executable", "seconds"),
    [*((NODE, seconds) for seconds in (0.0, 0.2, 0.5, 1.0, 2.0, 5.0)), (ALIGN, 0.5), (ALIGN, 3.0)],
)
def test_a_signal_ends_it(
    tmp_path: Path, executable: Path, seconds: float, end: signal.Signals
) -> None:
    """At any moment of its start."""
    with running(executable, tmp_path / "log") as node:
        while not blocks_signals(node.pid):
            time.sleep(0.002)
        time.sleep(seconds)
        node.send_signal(end)
        assert node.wait(10.0) == 0, (tmp_path / "log").read_text()
    text = (tmp_path / "log").read_text()
    assert "Traceback" not in text and "rror" not in text, text


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["-p", "mode:=odom"], "mode"),
        (["-p", "points_topic:=my points"], "my points"),
        (["-p", "use_sim_time:=5"], "use_sim_time"),
        (["-r", "__ns:=my robot"], "my robot"),
        (["--params-file", "/nowhere.yaml"], "/nowhere.yaml"),
    ],
)
def test_what_refuses_to_start(tmp_path: Path, arguments: list[str], cause: str) -> None:
    with running(NODE, tmp_path / "log", *arguments) as node:
        assert node.wait(WAIT_S) == os.EX_CONFIG, (tmp_path / "log").read_text()
    lines = (tmp_path / "log").read_text().splitlines()
    ours = [line for line in lines if "[rcl]" not in line]
    assert len(ours) == 1 and cause in ours[0], lines


def test_humble_is_refused() -> None:
    script = (
        "import rclpy.node as node; del node.Node.add_post_set_parameters_callback; "
        "from segloc_ros.process import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == os.EX_CONFIG
    assert "Humble" in done.stderr and len(done.stderr.splitlines()) == 1
