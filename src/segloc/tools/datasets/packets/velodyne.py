"""Captures of Velodyne packets (``.pcap``), one scan per turn of the sensor.

Format: packets of 12 blocks, manuals of the VLP-16 and HDL-32E; decoded by velodyne-decoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import DatasetError, requires
from ....system.budget import check_points
from ....types import Float64, Int64, Scan
from ...io.fields import brief, faults_of
from ..layout import choose, drop_missing_returns
from ..recorded import Found
from .captures import datagrams, map_file

NAME = "Velodyne packets"
INNER: tuple[str, ...] = ()
PACKET = 1206  # bytes
_POINTS_PER_PACKET = 12 * 32
_BLOCK = b"\xff\xee"
_PRODUCTS = {"HDL32E": 0x21, "VLP16": 0x22, "PuckHiRes": 0x24, "VLP32C": 0x28}
"""The byte that ends a packet, by sensor model."""
_MAX_HDL32E_US = 70.0
"""Time per step of the azimuth [us]. A block of the HDL-32E holds one firing of 32 lasers, 46 us; a
block of the VLP-16 holds two of 16 lasers, 111 us."""
_TURN, _LATE = 36000, 2000
"""A turn, and how far a packet may be behind the one before: the network exchanged them [0.01 deg].
"""
_PAUSE_S = 0.25  # longer than a turn; one ends there
_MIN_PACKETS = 8  # per turn; turns at the ends of a capture have fewer


def recognises(path: Path) -> bool:
    return path.suffix == ".pcap" and path.is_file()


def find(path: Path, topic: str | None) -> Found:
    """List the turns of one sensor.

    ``topic`` chooses one of several by address and port, or overrides the sensor model named in the
    packets: HDL32E, VLP16, PuckHiRes or VLP32C.
    """
    model, notes = topic if topic in _PRODUCTS else None, list[str]()
    senders = _packets(path, notes)
    if topic not in (None, model, *senders):
        known = ", ".join((*_PRODUCTS, *senders))
        raise DatasetError(f"{path}: no model or sensor {topic!r}; supported: {known}")
    own = choose(path, list(senders), None if model else topic) if senders else ""
    stamps, places, azimuths = senders.get(own, _NOTHING)
    order, turns = _turns_of(azimuths, stamps)
    stamps, places = stamps[order], places[order]
    if not len(turns):
        raise DatasetError(
            f"{path}: no Velodyne turn among its {len(places)} packets, and no Ouster metadata "
            f"beside it ({path.stem}.json)"
        )
    return Found(
        name=path.stem,
        format=NAME,
        source=TurnSource(path, stamps, places, turns, model),
        indices=np.arange(len(turns)),
        stamps=stamps[turns[:, 0]],
        frame="velodyne",
        fields="x y z intensity ring time",
        topic=topic,
        notes=tuple(notes),
    )


def _turns_of(azimuths: Int64, stamps: Float64) -> tuple[Int64, Int64]:
    """Return the order of packets by how far the sensor turned, and the turns.

    Each turn is its first packet of that order and the one after its last, (T, 2).
    """
    steps = np.diff(azimuths, prepend=azimuths[:1]) % _TURN
    steps = np.where(steps > _TURN - _LATE, steps - _TURN, steps)
    paused = np.diff(stamps, prepend=stamps[:1]) > _PAUSE_S
    turned = azimuths[:1] + np.cumsum(steps + 2 * _TURN * paused)
    order = np.argsort(turned, kind="stable")
    starts = np.flatnonzero(np.diff(turned[order] // _TURN)) + 1
    bounds = np.concatenate([[0], starts, [len(azimuths)]])
    turns = np.column_stack([bounds[:-1], bounds[1:]]).astype(np.int64)
    return order, turns[turns[:, 1] - turns[:, 0] >= _MIN_PACKETS]


_Packets = tuple[Float64, Int64, Int64]
_NOTHING: _Packets = np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64)


def _packets(path: Path, notes: list[str]) -> dict[str, _Packets]:
    """Return stamps, file offsets and first azimuths [0.01 deg] of data packets by sender."""
    found: dict[str, list[tuple[float, int, int]]] = {}
    with map_file(path) as data:
        for datagram in datagrams(data, notes=notes):
            ((place, size), *more) = datagram.pieces
            if size == PACKET and not more and data[place : place + 2] == _BLOCK:
                azimuth = int.from_bytes(data[place + 2 : place + 4], "little")
                found.setdefault(datagram.sender, []).append((datagram.stamp, place, azimuth))
    columns = {sender: tuple(zip(*rows, strict=True)) for sender, rows in found.items()}
    return {
        sender: (
            np.array(stamps, np.float64),
            np.array(places, np.int64),
            np.array(turned, np.int64),
        )
        for sender, (stamps, places, turned) in columns.items()
    }


@dataclass(frozen=True)
class TurnSource:
    """The turns of a capture."""

    path: Path
    stamps: Float64  # (P,) of each packet [s]
    places: Int64  # (P,) offset in the file
    turns: Int64  # (T, 2) first packet of each turn and the one after its last
    model: str | None  # sensor model; None: as named in the packets

    def where(self, k: int) -> str:
        return f"{self.path}: turn {k}"

    def read(self, k: int) -> Scan:
        with faults_of(self.path):
            packets = []
            first, stop = map(int, self.turns[k])
            check_points(_POINTS_PER_PACKET * (stop - first))
            with self.path.open("rb") as file:
                for i in range(first, stop):
                    file.seek(int(self.places[i]))
                    packets.append((float(self.stamps[i]), file.read(PACKET)))
            return decode(packets, self.where(k), self.model)


def decode(packets: Sequence[tuple[float, bytes]], where: str, model: str | None = None) -> Scan:
    """Decode stamped packets into points, with times after the first packet.

    where: name for messages
    model: sensor model; None: as named in the packets, except that early VLP-16 firmware, which
      names itself HDL-32E, is recognised

    Raise DatasetError if they cannot be decoded; names ``where``. Raise MissingDependency if
    velodyne-decoder is not installed.
    """
    with requires("velodyne-decoder", "packets", "reading Velodyne packets"):
        import velodyne_decoder
    check_points(_POINTS_PER_PACKET * len(packets))
    if not packets:  # the decoder aborts the process on none
        raise DatasetError(f"{where}: no packets")
    if any(len(data) != PACKET for _, data in packets):
        raise DatasetError(f"{where}: cut off: packet size differs from {PACKET} bytes")
    model = model or ("VLP16" if _is_early_vlp16([data for _, data in packets]) else None)
    last = b"" if model is None else bytes([_PRODUCTS[model]])
    try:
        decoder = velodyne_decoder.ScanDecoder(
            velodyne_decoder.Config(timestamp_first_packet=True, cut_angle=None)
        )
        vector = velodyne_decoder.PacketVector()
        for stamp, data in packets:
            named = data[: PACKET - len(last)] + last
            vector.append(velodyne_decoder.VelodynePacket(stamp, named))
        points: Any = np.asarray(decoder.decode(vector)[1])
    except (RuntimeError, ValueError, TypeError) as error:
        raise DatasetError(f"{where}: {brief(error)}") from error
    return drop_missing_returns(points[:, :3], points[:, 4].astype(np.float64))


def _is_early_vlp16(packets: Sequence[bytes]) -> bool:
    """Return whether packets named HDL-32E turn too slowly from block to block to be one."""
    if len(packets) < 2 or any(data[-1] != _PRODUCTS["HDL32E"] for data in packets):
        return False
    clock = np.array([int.from_bytes(data[1200:1204], "little") for data in packets], np.int64)
    azimuths = {packets[0][at : at + 2] for at in range(2, 1200, 100)}  # dual returns share one
    return bool(np.median(np.diff(clock)) / len(azimuths) > _MAX_HDL32E_US)
