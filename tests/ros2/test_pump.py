"""The node's threads: a flood of clouds, and maps that cannot be read."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from samples.plaza import Plaza
from samples.ros_drive import BASE, LIDAR, MOUNT, ODOM, cloud_of, on_tf_static
from samples.streams import walked
from segloc_ros.core import Robot, Settings
from segloc_ros.core.diagnosis import Diagnosis, Level, diagnose
from segloc_ros.core.pump import Pump

from segloc import Localizer, geometry
from segloc.tools.io import write_scan

WAIT_S = 60.0


@contextmanager
def pumping(path: str, notes: list[str] | None = None, **parameters: Any) -> Iterator[Pump]:
    notes = [] if notes is None else notes
    values = {"map": path, "trigger": "periodic", "query_every_m": 4.0, **parameters}
    robot = Robot(Settings.of(values))
    on_tf_static(robot)
    robot.maps.note = notes.append
    pump = Pump(robot, lambda replies: None, lambda localizer: None, watch_s=0.05)
    try:
        yield pump
    finally:
        pump.end()
        assert pump.error is None


def until(pump: Pump, true: Callable[[Diagnosis], bool]) -> Diagnosis:
    end = time.monotonic() + WAIT_S
    while not true(told := pump.read(diagnose)):
        assert time.monotonic() < end, told
        time.sleep(0.02)
    return told


def test_a_flood_of_clouds_does_not_delay_odometry(
    localizer: Localizer, plaza: Plaza, tmp_path: Path
) -> None:
    """Clouds come ten times as fast as they are processed; odometry and readers get in between."""
    clouds, odometry, taken = 40, 400, []
    localizer.prior_map.save(tmp_path / "site.segmap")
    with pumping(str(tmp_path / "site.segmap")) as pump:
        until(pump, lambda told: "map is being read" not in told.message)
        slow = threading.Event()

        def on_cloud(robot: Robot) -> list[Any]:
            taken.append("cloud")
            slow.wait(0.05)
            return []

        def on_odometry(robot: Robot) -> list[Any]:
            taken.append("odometry")
            return []

        for k in range(odometry):
            if k % (odometry // clouds) == 0:
                pump.feed(on_cloud, is_scan=True)
            pump.feed(on_odometry)
            time.sleep(5e-4)
            if k % 100 == 0:
                begun = time.monotonic()
                pump.read(diagnose)
                assert time.monotonic() - begun < 1.0
        told = until(pump, lambda told: taken.count("odometry") == odometry)
        assert int(told.values["skipped"]) > 0 and taken.count("cloud") < clouds

        for events, _ in walked(plaza, 3):
            before, main, behind = events
            for event in (before, behind):
                T = event.T_odom_base @ geometry.inverse(MOUNT)
                pump.feed(
                    partial(Robot.on_odometry, stamp=event.stamp, parent=ODOM, child=BASE, T=T)
                )
            cloud = cloud_of(main.scan.points)
            on_main = partial(Robot.on_cloud, cloud=cloud, stamp=main.stamp, frame=LIDAR)
            pump.feed(on_main, is_scan=True)
            until(pump, lambda told, k=main.stamp: told.values.get("stamp") == f"{k:.3f}")
        until(pump, lambda told: told.message == "localized")


def test_input_that_waits_is_measured() -> None:
    def slowly(robot: Robot) -> list[Any]:
        time.sleep(1.2)
        return []

    with pumping("") as pump:
        pump.feed(slowly)
        pump.feed(lambda robot: [])
        told = until(pump, lambda told: float(told.values["behind_s"]) > 1.0)
        assert float(told.values["behind_s"]) < WAIT_S


def test_a_damaged_map_is_reported_and_the_one_in_use_stays(
    localizer: Localizer, tmp_path: Path
) -> None:
    path = tmp_path / "site.segmap"
    with pumping(str(path)) as pump:
        told = until(pump, lambda told: "No such file" in told.message)
        assert told.level is Level.ERROR and told.values["map"] == str(path)
        localizer.prior_map.save(path)
        until(pump, lambda told: told.message.startswith("no cloud yet"))
        assert pump.read(diagnose).values["map fault"] == ""
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
        told = until(pump, lambda told: told.values["map fault"] != "")
        assert "site.segmap" in told.values["map fault"]
        localizer.prior_map.save(path)
        until(pump, lambda told: told.values["map fault"] == "")
        faults: list[str] = []
        pump.load(str(tmp_path / "other.segmap"), None, faults.append)
        told = until(pump, lambda told: "other.segmap" in told.values["map fault"])
        assert told.values["map"] == str(path) and "other.segmap" in faults[0]


def test_a_cloud_becomes_the_map_and_is_read_from_its_cache_until_it_changes(
    plaza: Plaza, tmp_path: Path
) -> None:
    """A file at start and a changed one meanwhile, with progress; a damaged cache; a folder."""
    site, points, notes = tmp_path / "site.pcd", plaza.points[::3], list[str]()
    write_scan(site, points)
    seen: set[str] = set()

    def is_read(told: Diagnosis) -> bool:
        seen.add(f"{told.level.name} {told.message}")
        return told.message.startswith("no cloud yet")

    with pumping(str(site), notes) as pump:
        until(pump, is_read)
        assert any(message.startswith("WARN building the map of site.pcd") for message in seen)
        (cache,) = tmp_path.glob("site.pcd.*.segmap")
        assert notes[1:] == [f"map cached as {cache}"]
    built = cache.stat().st_mtime_ns
    with pumping(str(site), notes) as pump:
        until(pump, is_read)
        assert cache.stat().st_mtime_ns == built and len(notes) == 2
        write_scan(tmp_path / "other.pcd", points + [3.0, 0.0, 0.0])
        (tmp_path / "other.pcd").replace(site)
        until(pump, lambda told: len(notes) == 4)
        (other,) = set(tmp_path.glob("site.pcd.*.segmap")) - {cache}
        other.write_bytes(other.read_bytes()[:1000])
    with pumping(str(site), notes) as pump:
        until(pump, is_read)
        assert "built again" in notes[4] and notes[6] == f"map cached as {other}"
        faults: list[str] = []
        (tmp_path / "tiles").mkdir()
        write_scan(tmp_path / "tiles" / "a.pcd", points)
        pump.load(str(tmp_path / "tiles"), None, faults.append)
        until(pump, lambda told: faults == [""])
    assert len(list(tmp_path.glob("tiles.*.segmap"))) == 1


def test_a_node_ends_while_it_builds_a_map(plaza: Plaza, tmp_path: Path) -> None:
    write_scan(tmp_path / "site.pcd", plaza.points)
    with pumping(str(tmp_path / "site.pcd")) as pump:
        until(pump, lambda told: "building" in told.message)
    assert not list(tmp_path.glob("*.segmap"))
