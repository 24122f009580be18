"""What a VLP-16 sends, and captures of it."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

from samples.datasets import START, write_pcap
from samples.ouster import ip_packets

FIRING_US = 55.296  # of the VLP-16: a sequence of 16 lasers; two in a block, 12 blocks in a packet
LASERS_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
REACH_M, RIPPLE_M = 10.0, 0.04


def packets(turns: float, product: int = 0x22) -> list[tuple[float, bytes]]:
    """What a VLP-16 in the middle of a sphere sends at 10 Hz; one wall is nearer."""
    sent = []
    for number in range(round(turns * 1800 / 24)):
        data = b""
        for block in range(12):
            azimuth = (number * 12 + block) * 40 % 36000
            reach = REACH_M / 2 if 9000 <= azimuth < 18000 else REACH_M  # behind to the right
            reach += RIPPLE_M * (azimuth % 2360 / 1180 - 1)  # no exact sphere, which is no surface
            returns = struct.pack("<HB", round(reach / 0.002), 10) * 32
            data += b"\xff\xee" + struct.pack("<H", azimuth) + returns
        time = number * 24 * FIRING_US * 1e-6
        data += struct.pack("<IBB", round(time * 1e6), 0x37, product)  # strongest return
        sent.append((START + time, data))
    return sent


def capture(
    path: Path,
    sent: list[tuple[float, bytes]],
    order: str = "<",
    unit: int = 10**6,
    ports: Sequence[int] = (2368,),
) -> Path:
    """A capture of one sensor, or of one on each port."""
    frames = [
        (stamp, frame)
        for k, (stamp, data) in enumerate(sent)
        for port in ports
        for frame in ip_packets(data, k, port)
    ]
    return write_pcap(path, frames, order, unit)
