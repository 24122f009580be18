"""Captures of network packets in libpcap format, and the UDP datagrams in them.

Formats: wiki.wireshark.org/Development/LibpcapFileFormat; link types as tcpdump.org lists them;
RFC 791 (IP with fragments) and RFC 768 (UDP).
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ....errors import DatasetError

_ORDERS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
"""Byte order and unit of time by the magic number."""
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_HEADER = 24
_LINKS = {0: 4, 1: 14, 12: 0, 14: 0, 101: 0, 108: 4, 113: 16, 276: 20}
"""Bytes before the IP header: BSD loopback, Ethernet, raw IP, Linux cooked capture."""
_ETHERNET = 1
_VLAN = (b"\x81\x00", b"\x88\xa8")
_UDP = 17
_MAX_PENDING = 64  # incomplete datagrams kept
_MAX_PACKET = 1 << 18  # bytes, of libpcap; more is left only after a damaged header


class Record(NamedTuple):
    """Captured packet: stamp [s], and offset and size in the file."""

    stamp: float
    start: int
    size: int


class Datagram(NamedTuple):
    """A UDP datagram."""

    stamp: float  # of its first fragment [s]
    first: int  # offset of its first record in the file
    stop: int  # offset after its last record
    sender: str  # address, and destination port: one sensor
    port: int  # destination
    pieces: list[tuple[int, int]]  # start and size of each part of the payload

    @property
    def size(self) -> int:
        return sum(size for _, size in self.pieces)

    def content(self, data: mmap.mmap) -> bytes:
        """Return the payload."""
        return b"".join(data[start : start + size] for start, size in self.pieces)


@contextmanager
def map_file(path: Path) -> Iterator[mmap.mmap]:
    """Map a capture into memory.

    Raise DatasetError if the file is not a capture.
    """
    if path.stat().st_size < _HEADER:
        raise DatasetError(f"{path}: cut off: shorter than the header of a capture")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[:4] == _PCAPNG:
            raise DatasetError(f"{path}: pcapng is not supported: convert it with editcap -F pcap")
        if data[:4] not in _ORDERS:
            raise DatasetError(f"{path}: not a capture in libpcap format")
        yield data


def records(
    data: mmap.mmap,
    first: int = _HEADER,
    stop: int | None = None,
    notes: list[str] | None = None,
) -> Iterator[Record]:
    """Yield the packets between two offsets of a capture, except a truncated one.

    ``notes`` gets a line if much is left that cannot be read.
    """
    order, unit = _ORDERS[data[:4]]
    head = struct.Struct(f"{order}IIII")
    end = len(data) if stop is None else min(stop, len(data))
    place = first
    while place + head.size <= end:
        seconds, fraction, size, _ = head.unpack_from(data, place)
        place += head.size + size
        if place > end:
            left = end - (place - size)
            if notes is not None and left > _MAX_PACKET:
                notes.append(f"damaged at byte {end - left}: {left / 1e6:.1f} MB after it left out")
            break
        yield Record(seconds + unit * fraction, place - size, size)


def datagrams(
    data: mmap.mmap,
    first: int = _HEADER,
    stop: int | None = None,
    notes: list[str] | None = None,
) -> Iterator[Datagram]:
    """Yield the UDP datagrams over IPv4 between two offsets of a capture, by their ends.

    ``notes`` is that of :func:`records`.
    """
    order, _ = _ORDERS[data[:4]]
    (link,) = struct.unpack_from(f"{order}I", data, 20)
    pending: dict[bytes, _Parts] = {}
    for record in records(data, first, stop, notes):
        found = _ip(data, record, link & 0xFFFF)
        if found is None:
            continue
        key, offset, more, start, size = found
        parts = pending.pop(key, None) if offset or more else None
        parts = parts or _Parts(record, source=key[2:6])
        parts.add(offset, start, size, more, record)
        if parts.whole:
            if (datagram := parts.datagram(data)) is not None:
                yield datagram
            continue
        pending[key] = parts
        if len(pending) > _MAX_PENDING:
            del pending[next(iter(pending))]


def _ip(data: mmap.mmap, record: Record, link: int) -> tuple[bytes, int, bool, int, int] | None:
    """Return a UDP packet's datagram key, offset in it, whether more follows, start and size."""
    if link not in _LINKS:
        return None
    ip, end = record.start + _LINKS[link], record.start + record.size
    if link == _ETHERNET:
        while ip < end and data[ip - 2 : ip] in _VLAN:
            ip += 4
    if ip + 20 > end or data[ip] >> 4 != 4 or data[ip + 9] != _UDP:
        return None
    head = (data[ip] & 15) * 4
    length, _, place = struct.unpack_from(">HHH", data, ip + 2)
    if length < head or ip + length > end:
        return None
    key = data[ip + 4 : ip + 6] + data[ip + 12 : ip + 20]
    return key, (place & 0x1FFF) * 8, bool(place & 0x2000), ip + head, length - head


class _Parts:
    """The fragments of a datagram."""

    def __init__(self, record: Record, source: bytes) -> None:
        self._source = ".".join(map(str, source))
        self._first, self._stamp = record.start - 16, record.stamp
        self._stop, self._total, self._size = 0, -1, 0
        self._parts: dict[int, tuple[int, int]] = {}

    def add(self, offset: int, start: int, size: int, more: bool, record: Record) -> None:
        self._size += size - self._parts.get(offset, (0, 0))[1]
        self._parts[offset] = (start, size)
        self._stop = record.start + record.size
        if not more:
            self._total = offset + size

    @property
    def whole(self) -> bool:
        return self._size == self._total

    def datagram(self, data: mmap.mmap) -> Datagram | None:
        """Return the datagram without its header; None if its fragments do not fit."""
        pieces = [self._parts[offset] for offset in sorted(self._parts)]
        start, size = pieces[0]
        if size < 8:
            return None
        (port,) = struct.unpack_from(">H", data, start + 2)
        pieces[0] = (start + 8, size - 8)
        sender = f"{self._source}:{port}"
        return Datagram(self._stamp, self._first, self._stop, sender, port, pieces)
