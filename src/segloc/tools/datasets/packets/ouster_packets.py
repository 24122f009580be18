"""Ouster packets: points from a sensor's metadata and its packets.

Format: the Ouster Sensor Documentation, "Lidar Data Packet Format" and "Coordinate Frames and XYZ
Calculation". ouster-sdk is not used: it pins an old version of rosbags. Of dual returns the first,
stronger one is used.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .... import geometry
from ....errors import DatasetError
from ....system.budget import check_points, most_points
from ....types import Float64, Int64, Pose, Scan
from ...io.fields import brief
from ..layout import drop_missing_returns

LEGACY = "LEGACY"
PIXEL_BYTES = {
    LEGACY: 12,
    "RNG19_RFL8_SIG16_NIR16": 12,
    "RNG19_RFL8_SIG16_NIR16_DUAL": 16,
    "RNG19_RFL8_SIG16_NIR16_ZONE16": 12,
    "RNG19_RFL8_SIG16_ZONE16_DUAL": 16,
    "RNG19_RFL8_SIG16_NIR16_RGB16": 16,
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": 20,
    "RNG15_RFL8_NIR8": 4,
    "RNG15_RFL8_WIN8": 4,
    "RNG15_RFL8_NIR8_DUAL": 8,
    "RNG15_RFL8_NIR8_ZONE16": 8,
    "FUSA_RNG15_RFL8_NIR8_DUAL": 8,
}
"""Bytes of a pixel by packet profile; the range comes first in all of them."""
_RANGES = {"LEGACY": ("<u4", 0xFFFFF, 1e-3), "RNG19": ("<u4", 0x7FFFF, 1e-3),
           "RNG15": ("<u2", 0x7FFF, 8e-3)}  # fmt: skip
"""Type, mask and unit (m) of the range."""
FRAME = "os_sensor"
FIELDS = "range reflectivity time"
_MAX_COLUMNS = 1 << 15
IMU_BYTES = 48
"""Size of an IMU packet: three times of 8 bytes, acceleration [g], angular velocity [deg/s]."""
_IMU_ACCELERATION = 24
_MIN_PACKETS = 8  # per turn; turns at the ends of a recording have fewer


@dataclass(frozen=True)
class Turns:
    """Packets of each of T turns."""

    numbers: Int64  # (T,) frame id of the packets
    stamps: Float64  # (T,) of the first packet [s]
    firsts: Int64  # (T,) position of the first packet
    stops: Int64  # (T,) position after the last
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass
class _Turn:
    number: int
    stamp: float
    first: int
    stop: int
    packets: int = 1


def gather(packets: Iterable[tuple[int, float, int, int]], sensor: Sensor) -> Turns:
    """Group packets (number, stamp, start, stop) into turns.

    A late packet belongs to the turn before. Incomplete turns of few packets, such as the first
    and last of a recording, are dropped.
    """
    turns: list[_Turn] = []
    for number, stamp, first, stop in packets:
        turn = next((turn for turn in turns[:-3:-1] if turn.number == number), None)
        if turn is None:
            turns.append(_Turn(number, stamp, first, stop))
        else:
            turn.stop, turn.packets = max(turn.stop, stop), turn.packets + 1
    wanted = sensor.columns // sensor.packet["columns"].shape[0]
    kept = [turn for turn in turns if turn.packets >= min(_MIN_PACKETS, wanted)]
    missing = sum(turn.packets < wanted for turn in kept[1:-1])
    return Turns(
        np.array([turn.number for turn in kept], np.int64),
        np.array([turn.stamp for turn in kept], np.float64),
        np.array([turn.first for turn in kept], np.int64),
        np.array([turn.stop for turn in kept], np.int64),
        (f"{missing} of {len(kept)} turns miss packets",) if missing else (),
    )


@dataclass(frozen=True)
class Sensor:
    """Sensor as described by its metadata."""

    packet: np.dtype[np.void]  # ``columns`` with ``time``, ``number``, ``status`` and ``pixels``
    columns: int  # per turn
    port: int  # destination of LiDAR packets; 0 if unknown
    id_type: str  # type and offset of the frame id in a packet
    id_place: int
    mask: int  # of ranges
    unit_m: float  # of ranges
    altitudes: Float64  # (P,) of the beams [rad]
    azimuths: Float64  # (P,) of the beams [rad]
    T_lidar_beam: Pose  # (4, 4) beam origin, off the sensor's axis
    T_sensor_lidar: Pose  # (4, 4)
    T_sensor_imu: Pose  # (4, 4)
    imu_port: int  # destination of IMU packets; 0 if unknown
    legacy_imu: bool  # True if IMU packets have the supported layout

    def is_lidar(self, size: int, port: int) -> bool:
        """Return whether a datagram's size and port are those of a LiDAR packet."""
        return size == self.packet.itemsize and (self.port in (0, port))

    def is_imu(self, size: int, port: int) -> bool:
        """Return whether a datagram's size and port are those of an IMU packet."""
        return self.legacy_imu and size == IMU_BYTES and self.imu_port in (0, port)

    def acceleration(self, packet: bytes) -> Float64:
        """Return the acceleration (3,) of an IMU packet [g], up at rest, in the sensor's frame."""
        raw = np.frombuffer(packet, "<f4", 3, _IMU_ACCELERATION).astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            turned: Float64 = self.T_sensor_imu[:3, :3] @ raw
        return turned

    @property
    def most_packets(self) -> int:
        """Maximum number of packets in a scan."""
        return most_points() // (int(self.packet["columns"].shape[0]) * len(self.altitudes))

    def frame_id(self, packet: bytes) -> int:
        """Return the number of the turn that a packet belongs to (16 bits)."""
        return int(np.frombuffer(packet, self.id_type, 1, self.id_place)[0]) & 0xFFFF

    def decode(self, packets: Sequence[bytes], number: int, where: str) -> Scan:
        """Decode the packets of turn ``number`` into points in the sensor's frame.

        Times are seconds after the first column. Pixels without a return are dropped.

        Raise DatasetError if none of the packets belongs to the turn; names ``where``.
        """
        if len(packets) > self.most_packets:
            check_points(most_points() + 1, "or more points in one turn")
        whole = [packet for packet in packets if self.frame_id(packet) == number]
        if not whole:
            raise DatasetError(
                f"{where}: packets missing: the file has changed since it was opened"
            )
        columns = np.frombuffer(b"".join(whole), self.packet)["columns"].reshape(-1)
        columns = columns[(columns["status"] & 1 == 1) & (columns["number"] < self.columns)]
        ranges = (columns["pixels"]["range"] & self.mask) * self.unit_m
        points = self._points(ranges, columns["number"])
        since = columns["time"] - columns["time"].min(initial=np.iinfo(np.uint64).max)
        times = np.repeat(since.astype(np.float64) * 1e-9, len(self.altitudes))
        points[ranges.reshape(-1) == 0] = 0.0
        return drop_missing_returns(points, times)

    def _points(self, ranges: Float64, numbers: np.ndarray) -> Float64:
        """Return points (C * P, 3) of ranges (C, P) in columns with these numbers."""
        B = self.T_lidar_beam[:3, 3]
        reach = ranges - np.hypot(B[0], B[2])
        encoder = 2 * np.pi * (1 - numbers / self.columns)[:, None]
        turned = encoder - self.azimuths
        flat = reach * np.cos(self.altitudes)
        x = flat * np.cos(turned) + B[0] * np.cos(encoder)
        y = flat * np.sin(turned) + B[0] * np.sin(encoder)
        z = reach * np.sin(self.altitudes) + B[2]
        points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        return geometry.transform(self.T_sensor_lidar, points)


def read_sensor(text: bytes | str, where: str) -> Sensor:
    """Read a sensor from metadata in any layout of firmware and drivers.

    Raise DatasetError if a value is missing or invalid; names ``where``.
    """
    try:
        document = json.loads(text)
        return _sensor(_flat(document))
    except DatasetError as error:
        raise DatasetError(f"{where}: {error}") from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise DatasetError(f"{where}: not Ouster metadata: {brief(error)}") from error


def _flat(document: Any) -> dict[str, Any]:
    """Return all entries at one level: newer firmware groups them."""
    if not isinstance(document, dict):
        raise DatasetError("not Ouster metadata: no JSON object")
    entries = dict(document)
    for group in document.values():
        if isinstance(group, dict):
            entries |= group
    return entries


def _sensor(entries: dict[str, Any]) -> Sensor:
    altitudes, azimuths = (_numbers(entries, f"beam_{kind}_angles")
                           for kind in ("altitude", "azimuth"))  # fmt: skip
    rows = len(altitudes)
    if not rows or len(azimuths) != rows:
        raise DatasetError(f"{rows} altitudes and {len(azimuths)} azimuths of beams")
    profile = str(entries.get("udp_profile_lidar", LEGACY))
    if profile not in PIXEL_BYTES:
        raise DatasetError(f"unsupported packet profile {profile[:40]!r}")
    columns = _count(entries, "columns_per_frame", str(entries.get("lidar_mode", "")).split("x")[0])
    packed = _count(entries, "columns_per_packet", 16)
    if _count(entries, "pixels_per_column", rows) != rows:
        raise DatasetError(f"{rows} beams, but {entries['pixels_per_column']} pixels per column")
    kind = next(name for name in _RANGES if name in profile)
    dtype, mask, unit = _RANGES[kind]
    wide = str(entries.get("header_type", "")) == "FUSA" or profile.startswith("FUSA")
    legacy = profile == LEGACY
    return Sensor(
        packet=_layout(rows, packed, PIXEL_BYTES[profile], dtype, legacy),
        columns=columns,
        port=int(entries.get("udp_port_lidar") or 0),
        id_type="<u4" if wide and not legacy else "<u2",
        id_place=10 if legacy else 4 if wide else 2,
        mask=mask,
        unit_m=unit,
        altitudes=np.radians(altitudes),
        azimuths=np.radians(azimuths),
        T_lidar_beam=_beam_origin(entries),
        T_sensor_lidar=_matrix(entries, "lidar_to_sensor_transform"),
        T_sensor_imu=_matrix(entries, "imu_to_sensor_transform"),
        imu_port=int(entries.get("udp_port_imu") or 0),
        legacy_imu=str(entries.get("udp_profile_imu", LEGACY)) == LEGACY,
    )


def _layout(rows: int, columns: int, size: int, range_type: str, legacy: bool) -> np.dtype[np.void]:
    """Return the dtype of a packet: a header, columns with a header each, a footer."""
    before, after, ends = (16, 4, 0) if legacy else (12, 0, 32)
    pixel = np.dtype(
        {"names": ["range"], "formats": [range_type], "offsets": [0], "itemsize": size}
    )
    column = np.dtype(
        {
            "names": ["time", "number", "status", "pixels"],
            "formats": ["<u8", "<u2", "<u4" if legacy else "<u2", (pixel, (rows,))],
            "offsets": [0, 8, before + rows * size if legacy else 10, before],
            "itemsize": before + rows * size + after,
        }
    )
    total = 2 * ends + columns * column.itemsize
    return np.dtype({"names": ["columns"], "formats": [(column, (columns,))], "offsets": [ends],
                     "itemsize": total})  # fmt: skip


def _numbers(entries: dict[str, Any], key: str) -> Float64:
    if key not in entries:
        raise DatasetError(f"{key!r} is missing")
    values = np.asarray(entries[key], dtype=np.float64)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise DatasetError(f"{key!r} is not a list of numbers")
    return values


def _count(entries: dict[str, Any], key: str, default: int | str) -> int:
    value = int(entries.get(key, default))
    if not 0 < value < _MAX_COLUMNS:
        raise DatasetError(f"{key!r} is {value}, must be 1 to {_MAX_COLUMNS - 1}")
    return value


def _matrix(entries: dict[str, Any], key: str) -> Pose:
    """Return a transform of 16 numbers, row by row, lengths in mm; identity if missing."""
    if key not in entries:
        return np.eye(4)
    T = np.array(_numbers(entries, key).reshape(4, 4))
    T[:3, 3] *= 1e-3
    return T


def _beam_origin(entries: dict[str, Any]) -> Pose:
    if "beam_to_lidar_transform" in entries:
        return _matrix(entries, "beam_to_lidar_transform")
    T = np.eye(4)
    T[0, 3] = 1e-3 * float(entries.get("lidar_origin_to_beam_origin_mm", 0.0))
    if not math.isfinite(T[0, 3]):
        raise DatasetError("'lidar_origin_to_beam_origin_mm' is not a number")
    return T
