"""Packets of an Ouster, written byte for byte as the sensor's documentation describes them."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from samples.datasets import START, write_pcap
from segloc.types import Float64

PIXELS = {
    "LEGACY": 12,
    "RNG19_RFL8_SIG16_NIR16": 12,
    "RNG19_RFL8_SIG16_NIR16_DUAL": 16,
    "RNG15_RFL8_NIR8": 4,
    "RNG15_RFL8_NIR8_DUAL": 8,
    "FUSA_RNG15_RFL8_NIR8_DUAL": 8,
}
COLUMNS, PACKED = 512, 16
PORT = 7502
TURN_S = 0.1


@dataclass
class Ouster:
    """A sensor of eight beams that turns at 10 Hz.

    Attributes
    ----------
    profile : str
        One of ``PIXELS``.
    altitudes, azimuths : list of float
        Of the beams, degrees.
    boot_s : float
        What the sensor's clock shows at START.
    """

    profile: str = "RNG19_RFL8_SIG16_NIR16"
    altitudes: list[float] = field(default_factory=lambda: [12.0, 8, 4, 0, -4, -8, -12, -16])
    azimuths: list[float] = field(default_factory=lambda: [3.0, 1, -1, 0] * 2)
    boot_s: float = 77.0

    def metadata(self, layout: str = "new") -> dict[str, Any]:
        """As recent firmware groups them, or all in one as older does, or the oldest."""
        beams = {
            "beam_altitude_angles": self.altitudes,
            "beam_azimuth_angles": self.azimuths,
            "lidar_origin_to_beam_origin_mm": 15.8,
        }
        lidar = {
            "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]
        }
        data = {
            "columns_per_frame": COLUMNS,
            "columns_per_packet": PACKED,
            "pixels_per_column": len(self.altitudes),
            "pixel_shift_by_row": [0] * len(self.altitudes),
            "column_window": [0, COLUMNS - 1],
            "udp_profile_lidar": self.profile,
        }
        if self.profile.startswith("FUSA"):
            data["header_type"] = "FUSA"
        if layout == "oldest":
            return {"lidar_mode": f"{COLUMNS}x10", "prod_line": "OS-1-8", **beams, **lidar}
        if layout == "old":
            return {"lidar_mode": f"{COLUMNS}x10", "data_format": data, **beams, **lidar}
        config = {"lidar_mode": f"{COLUMNS}x10", "udp_port_lidar": PORT}
        transform = np.eye(4)
        transform[0, 3] = beams["lidar_origin_to_beam_origin_mm"]
        return {
            "beam_intrinsics": {**beams, "beam_to_lidar_transform": transform.ravel().tolist()},
            "lidar_intrinsics": lidar,
            "imu_intrinsics": {"imu_to_sensor_transform": np.eye(4).ravel().tolist()},
            "calibration_status": {},
            "lidar_data_format": data,
            "sensor_info": {"prod_line": "OS-1-8", "prod_sn": "0", "build_rev": "v3.0.0",
                            "image_rev": "ousteros-image-prod-aries-v3.0.0", "prod_pn": ""},
            "config_params": {**config, "udp_profile_lidar": self.profile},
        }  # fmt: skip

    def ranges(self, turn: int) -> Float64:
        """Millimetres, (columns, beams), whole steps of 8; one beam of every 50th has no return."""
        column, beam = np.mgrid[:COLUMNS, : len(self.altitudes)]
        steps = np.round(625 + 250 * np.cos(column * 4 * np.pi / COLUMNS) + 25 * beam + 60 * turn)
        return np.where((column % 50 == 3) & (beam == 1), 0, steps * 8)

    def time(self, turn: int, column: int) -> int:
        """Nanoseconds on the sensor's clock."""
        return round((self.boot_s + TURN_S * (turn + column / COLUMNS)) * 1e9)

    def packets(self, turns: int, first: int = 65534) -> list[tuple[float, bytes]]:
        """Those of some turns, numbered from ``first`` on, and when they arrive."""
        sent = []
        for turn in range(turns):
            ranges = self.ranges(turn)
            for start in range(0, COLUMNS, PACKED):
                columns = range(start, start + PACKED)
                data = self._packet(first + turn, [(turn, c, ranges[c]) for c in columns])
                sent.append((START + TURN_S * (turn + (start + PACKED) / COLUMNS), data))
        return sent

    def _packet(self, number: int, columns: list[tuple[int, int, Float64]]) -> bytes:
        size, legacy = PIXELS[self.profile], self.profile == "LEGACY"
        body = b""
        for turn, column, ranges in columns:
            time = self.time(turn, column)
            head = struct.pack("<QHH", time, column, number & 0xFFFF if legacy else 1)
            body += head + (struct.pack("<I", 88 * column) if legacy else b"")
            for value in ranges.astype(int).tolist():
                if "RNG15" in self.profile:
                    pixel = struct.pack("<H", value // 8 | 0x8000)  # a flag beside the range
                else:
                    pixel = struct.pack("<I", value | 0xAB000000)
                body += pixel + bytes([7]) * (size - len(pixel))
            body += struct.pack("<I", 0xFFFFFFFF) if legacy else b""
        if legacy:
            return body
        if self.profile.startswith("FUSA"):
            header = struct.pack("<BBHI", 1, 0, 0, number)
        else:
            header = struct.pack("<HH", 1, number & 0xFFFF)
        return header.ljust(32, b"\0") + body + bytes(32)


def ip_packets(content: bytes, number: int, port: int = PORT, mtu: int = 1500) -> list[bytes]:
    """A UDP datagram over IPv4 over Ethernet, in as many fragments as it needs."""
    datagram = struct.pack(">HHHH", 50000, port, 8 + len(content), 0) + content
    step = (mtu - 20) // 8 * 8
    frames = []
    for at in range(0, len(datagram), step):
        piece = datagram[at : at + step]
        more = 0x2000 if at + step < len(datagram) else 0
        size, flags = 20 + len(piece), more | at // 8
        head = struct.pack(">BBHHHBBH", 0x45, 0, size, number & 0xFFFF, flags, 64, 17, 0)
        frames.append(bytes(12) + b"\x08\x00" + head + bytes([10, 0, 0, 1, 10, 0, 0, 2]) + piece)
    return frames


def imu_packet(acceleration: tuple[float, float, float]) -> bytes:
    """What the sensor's IMU sends: three times, acceleration in g, angular velocity."""
    return struct.pack("<3Q6f", 1, 2, 3, *acceleration, 0.0, 0.0, 0.0)


def capture(
    path: Path,
    sent: list[tuple[float, bytes]],
    mtu: int = 1500,
    port: int = PORT,
    imu: bytes = bytes(48),
) -> Path:
    """A capture of datagrams, among those that an IMU sends."""
    stamped = []
    for number, (stamp, data) in enumerate(sent):
        frames = ip_packets(data, 2 * number, port, mtu)
        if number % 10 == 0:
            frames[1:1] = ip_packets(imu, 2 * number + 1, port + 1)
        stamped += [(stamp, frame) for frame in frames]
    return write_pcap(path, stamped)


def recorded(path: Path, sensor: Ouster, turns: int, layout: str = "new", **options: int) -> Path:
    """A capture with the metadata beside it."""
    path.with_suffix(".json").write_text(json.dumps(sensor.metadata(layout)))
    return capture(path, sensor.packets(turns), **options)
