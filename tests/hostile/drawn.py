"""Messages of a robot and layouts of bags, drawn from bytes: the same bytes, the same messages.

Numbers are those that drivers and broken programs write: mostly of a usual size, some not finite,
huge, negative or far off. What ROS itself makes impossible is not drawn: stamps are finite.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from operator import methodcaller
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
from samples.plaza import Plaza, PlazaSequence
from samples.ros_drive import cloud_of, livox_of

from segloc.types import Float64, Pose

T = TypeVar("T")
ODD = (0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e300, -1e30, 1e9, 3.4e38, 1e-300, 4e5, -6e6, 0.5)
FRAMES = ("map", "odom", "base_link", "os_sensor", "", "/os_sensor", "camera_init", "x" * 300, "\n")
TIMES = ("t", "time", "timestamp", "offset_time", "time_offset_ns", "x", "intensity", "\0", "ring")
WIDTHS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}  # of the datatypes of PointField
FIELD = ("name", "offset", "datatype", "count")
BEGUN_S = 1.75e9
CLOUD = "sensor_msgs/msg/PointCloud2"


class Draw:
    """Takes choices from bytes; zeros behind their end."""

    def __init__(self, data: bytes) -> None:
        self._bytes = iter(data)
        self._left = len(data)

    def __bool__(self) -> bool:
        """Whether bytes are left."""
        return self._left > 0

    def below(self, count: int) -> int:
        """A number from 0 to 255, below a count."""
        self._left -= 1
        return next(self._bytes, 0) % count

    def of(self, values: Sequence[T]) -> T:
        return values[self.below(len(values))]

    def number(self) -> float:
        """Three of four times of a usual size."""
        return self.below(256) / 8 - 16 if self.below(4) else float(self.of(ODD))

    def numbers(self, *shape: int) -> Float64:
        count = int(np.prod(shape))
        return np.array([self.number() for _ in range(count)]).reshape(shape)

    def stamp(self) -> float:
        """Mostly about a second later than the one before; seconds fit into 32 bits."""
        if self.below(8):
            return BEGUN_S + 0.1 * self.below(256)
        return float(self.of((0.0, -1.0, 2.0**31 - 1, -(2.0**31), BEGUN_S - 1e6, BEGUN_S + 1e6)))

    def quaternion(self) -> list[float]:
        """Mostly a turn about z."""
        if self.below(8):
            half = self.below(64) / 20
            return [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]
        return self.numbers(4).tolist()

    def pose(self) -> Pose | None:
        """As the node takes it in; None if it refuses it."""
        from segloc_ros.core.frames import pose_of

        from segloc.errors import SeglocError

        try:
            return pose_of(self.numbers(3).tolist(), self.quaternion())
        except SeglocError:
            return None

    def points(self) -> Float64:
        """A scan of the plaza, or walls and a floor, and some odd points."""
        if not self.below(3):
            return scan_of_plaza(self.below(15))
        count = self.of((0, 1, 3, 60, 900, 4000))
        rng = np.random.default_rng(self.below(256))
        points = rng.uniform(-12, 12, (count, 3)) * self.of(((1, 1, 0.2), (1, 0, 0.2), (1, 1, 0)))
        points[: self.below(9)] = self.number()
        if not self.below(6):
            points *= self.of((1e3, 1e-3, 1e7, 0.0))
        return points

    def cloud(self) -> tuple[list[tuple[str, int, int, int]], dict[str, Any]]:
        """Fields and values of a sensor_msgs/PointCloud2, mostly sound."""
        points = self.points()
        types = [self.of((7, 7, 7, 8)) for _ in range(3)]
        names = list("xyz")
        if self.below(2):
            names.append(self.of(TIMES))
            types.append(self.of((8, 7, 6, 5, 1, 2, 3, 4)))
        steps = [WIDTHS[each] for each in types]
        offsets = [*np.cumsum([0, *steps[:-1]]).tolist()]
        step, big = sum(steps) + self.of((0, 0, 4, 13)), not self.below(6)
        data = self._rows(points, types, offsets, step, ">" if big else "<")
        height = self.of((1, 1, 1, 4, 0, 2**31))
        width = len(points) // max(height, 1)
        values = {
            "height": height, "width": width, "is_bigendian": big, "point_step": step,
            "row_step": width * step, "is_dense": bool(self.below(2)), "data": data,
        }  # fmt: skip
        if not self.below(4):  # one that is wrong
            name = self.of(("height", "width", "point_step", "row_step"))
            values[name] = self.of((0, 1, values[name] + 1, 2**31, 2**32 - 1, values[name] // 2))
        counts = [self.of((1, 1, 1, 1, 1, 1, 0, 3, 2**32 - 1)) for _ in names]
        if not self.below(6):
            offsets[self.below(len(offsets))] = self.of((0, 1, step, 2**31, 2**32 - 1))
        if not self.below(6):
            types[self.below(len(types))] = self.of((0, 9, 255))
        if not self.below(6):
            values["data"] = data[: self.below(256) * max(1, len(data) // 256)]
        fields = list(zip(names, offsets, types, counts, strict=True))
        if not self.below(6):
            fields = fields[self.below(len(fields)) :]
        return fields, values

    def _rows(
        self, points: Float64, types: list[int], offsets: list[int], step: int, order: str
    ) -> Any:
        kinds = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
        rows = np.zeros((len(points), step), np.uint8)
        times = np.linspace(0, 1, len(points)) * self.of((0.1, 1.0, 1e5, 1e8, BEGUN_S, 1e18))
        columns = [*points.T, times][: len(types)]
        for column, kind, offset in zip(columns, types, offsets, strict=True):
            with np.errstate(all="ignore"):
                packed = column.astype(order + kinds[kind])
            width = WIDTHS[kind]
            packed_bytes = packed.view(np.uint8).reshape(len(points), width)
            rows[:, offset : offset + width] = packed_bytes
        return rows.reshape(-1)


@functools.cache
def plaza_walk() -> PlazaSequence:
    """The walk that the node's map is made of."""
    return PlazaSequence(Plaza(0))


@functools.cache
def scan_of_plaza(k: int) -> Float64:
    """A scan of that walk."""
    return plaza_walk().scan(k).points[::4].astype(np.float64)


def _sound_step(k: int, stamp: float) -> Iterator[methodcaller]:
    """Odometry and a cloud of the walk, as they are on a robot without faults."""
    pose = plaza_walk().poses[k]
    for late_s in (-0.05, 0.05):
        yield methodcaller("on_odometry", stamp + late_s, "odom", "base_link", pose)
    yield methodcaller("on_cloud", cloud_of(scan_of_plaza(k)), stamp, "os_sensor", "points")


def messages(draw: Draw) -> Iterator[methodcaller]:
    """What topics say until the bytes end, each to be given to the core of the node."""
    from segloc_ros.core.clicks import Click
    from segloc_ros.core.frames import Transform

    steps = 0
    if draw.below(8):
        mount = [Transform(0.0, "base_link", "os_sensor", np.eye(4))]
        yield methodcaller("on_transforms", mount, True)
    while draw:
        what, frame, stamp = draw.below(16), draw.of(FRAMES), draw.stamp()
        if what > 11:
            yield from _sound_step(steps % len(plaza_walk().poses), BEGUN_S + steps)
            steps += 1
            continue
        pose = draw.pose() if what in (0, 1, 2, 3, 4, 9) else None
        if what < 2 and pose is not None:
            transforms = [Transform(stamp, frame, draw.of(FRAMES), pose)]
            yield methodcaller("on_transforms", transforms, draw.below(2) == 0)
        elif what < 5 and pose is not None:
            odom = draw.of(("odom", frame))
            yield methodcaller("on_odometry", stamp, odom, "base_link", pose)
        elif what < 8:
            fields, values = draw.cloud()
            made = [SimpleNamespace(**dict(zip(FIELD, each, strict=True))) for each in fields]
            cloud = SimpleNamespace(fields=made, **values)
            yield methodcaller("on_cloud", cloud, stamp, draw.of(("os_sensor", frame)), "points")
        elif what == 8:
            yield methodcaller("on_acceleration", stamp, frame, draw.numbers(3))
        elif what == 9 and pose is not None:
            click = Click(draw.of(("map", frame)), pose, draw.numbers(6, 6))
            yield methodcaller("on_click", click)
        elif what == 10:
            yield methodcaller("on_fix", _fix(draw))
            yield methodcaller("report_silence")
        elif draw.below(2):
            yield methodcaller("on_livox", _livox(draw, frame, stamp))
        else:
            yield methodcaller(draw.of(("relocalize", "request_update")))


def _livox(draw: Draw, frame: str, stamp: float) -> bytes:
    """A CustomMsg of Livox in CDR, perhaps cut off or with other bytes in it."""
    data = bytearray(livox_of(draw.numbers(4, 3).astype(np.float32), stamp, frame))
    for _ in range(draw.below(4)):
        data[draw.below(64) % len(data)] = draw.below(256)
    return bytes(data[: len(data) - draw.below(8) * draw.below(8)])


def _fix(draw: Draw) -> Any:
    latitude, longitude, altitude = draw.numbers(3).tolist()
    return SimpleNamespace(
        status=SimpleNamespace(status=draw.of((0, -1, 127)), service=1),
        latitude=latitude, longitude=longitude, altitude=altitude,
        position_covariance=draw.numbers(9), position_covariance_type=draw.of((0, 2, 255)),
    )  # fmt: skip


def write_bag(data: bytes, folder: Path) -> Path:
    """Write a bag of a drawn layout: kind, topics, messages, and what is missing of its files."""
    from samples.bags import PACKING, BagWriter

    draw = Draw(data)
    kind = draw.of(("ros1", "sqlite3", "mcap"))
    writer = BagWriter(kind)
    while draw and len(writer.messages) < 24:
        _add(draw, writer)
    packed = kind != "mcap" and not draw.below(4)
    path = writer.write(folder / "drawn", PACKING[kind] if packed else "")
    files = [path] if path.is_file() else sorted(path.iterdir())
    harm = draw.below(6)
    if harm == 1 and path.is_dir():
        (path / "metadata.yaml").unlink()
    elif harm == 2:
        victim = draw.of(files)
        whole = victim.read_bytes()
        victim.write_bytes(whole[: len(whole) * draw.below(256) // 256])
    elif harm == 3:
        victim = draw.of(files)
        changed = bytearray(victim.read_bytes())
        for _ in range(1 + draw.below(9)):
            changed[draw.below(256) * len(changed) // 256] = draw.below(256)
        victim.write_bytes(changed)
    return path


def _add(draw: Draw, writer: Any) -> None:
    """Add a message; names, frames and numbers are not always sound."""
    what, stamp, frame = draw.below(8), abs(draw.stamp()) % 2**31, draw.of(FRAMES)
    topic = draw.of(("/points", "/other", "/odom", "/tf", "", "/tf_static"))
    if what < 3:
        fields, values = draw.cloud()
        kind = "sensor_msgs/msg/PointField"
        made = [writer.make(kind, **dict(zip(FIELD, each, strict=True))) for each in fields]
        header = writer.header(stamp, draw.of(("lidar", frame)))
        message = writer.make(CLOUD, header=header, fields=made, **values)
        writer.add(draw.of(("/points", topic)), CLOUD, stamp, message)
    elif what == 3:
        writer.odometry(
            draw.of(("/odom", topic)), stamp, _any_pose(draw), draw.of(("lidar", frame))
        )
    elif what == 4:
        parent, child = draw.of(("map", frame)), draw.of(("lidar", *FRAMES))
        writer.tf(draw.of(("/tf", "/tf_static")), stamp, _any_pose(draw), parent, child)
    elif what == 5:
        writer.imu("/imu", stamp, draw.numbers(3), frame)
    elif what == 6:
        writer.fix("/fix", stamp, tuple(draw.numbers(3).tolist()), None, draw.of((0, -1, 127)))
    else:
        with np.errstate(over="ignore"):
            step = float(np.float32(draw.number()))
        writer.laser("/laser", stamp, draw.numbers(draw.of((0, 1, 40))), step, 0.01)


def _any_pose(draw: Draw) -> Pose:
    """A pose that rosbags writes: its position may be anything."""
    from segloc import geometry

    T = geometry.yaw_transform(draw.below(64) / 10, (0.0, 0.0, 0.0))
    T[:3, 3] = draw.numbers(3)
    return T
