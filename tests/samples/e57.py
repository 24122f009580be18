"""E57 files (ASTM E2807) of scans with poses, uncompressed."""

from __future__ import annotations

import struct

from segloc.types import Float64

PAGE, PAYLOAD, HEADER = 1024, 1020, 48
PACKET = 2000
"""Points of a packet, which holds 64 KiB at most."""
_REVERSED_POLYNOMIAL = 0x82F63B78

Placed = tuple[Float64, tuple[float, ...], tuple[float, ...]]
"""Points (N, 3), and the quaternion w, x, y, z and translation of their scan."""


def e57_file(*scans: Placed) -> bytes:
    """A file of these scans, whose poses take the points to the file's frame."""
    body, text = bytearray(HEADER), ""
    for k, scan in enumerate(scans):
        text += _described(k, scan, _on_disk(len(body)))
        packets = b"".join(_packet(scan[0][i : i + PACKET]) for i in range(0, len(scan[0]), PACKET))
        section = 32 + len(packets)
        body += struct.pack("<B7xQQQ", 1, section, _on_disk(len(body) + 32), 0) + packets
    xml = (
        '<?xml version="1.0" encoding="UTF-8"?><e57Root type="Structure" '
        'xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0">'
        '<formatName type="String">ASTM E57 3D Imaging Data File</formatName>'
        '<guid type="String">file</guid><versionMajor type="Integer">1</versionMajor>'
        '<versionMinor type="Integer">0</versionMinor>'
        f'<data3D type="Vector" allowHeterogeneousChildren="1">{text}</data3D></e57Root>'
    ).encode()
    at = _on_disk(len(body))
    body += xml + bytes(-(len(body) + len(xml)) % PAYLOAD)
    pages = len(body) // PAYLOAD
    header = b"ASTM-E57", 1, 0, pages * PAGE, at, len(xml), PAGE
    body[:HEADER] = struct.pack("<8sIIQQQQ", *header)
    parts = (bytes(body[PAYLOAD * i : PAYLOAD * (i + 1)]) for i in range(pages))
    return b"".join(part + struct.pack(">I", _crc32c(part)) for part in parts)


def _on_disk(offset: int) -> int:
    """An offset with the checksums of the pages before it."""
    return offset + (PAGE - PAYLOAD) * (offset // PAYLOAD)


def _packet(points: Float64) -> bytes:
    streams = [points[:, axis].astype("<f8").tobytes() for axis in range(3)]
    sizes = b"".join(struct.pack("<H", len(stream)) for stream in streams)
    length = 6 + len(sizes) + sum(map(len, streams))
    filling = -length % 4
    head = struct.pack("<BBHH", 1, 0, length + filling - 1, 3)
    return head + sizes + b"".join(streams) + bytes(filling)


def _described(k: int, scan: Placed, offset: int) -> str:
    points, rotation, translation = scan

    def numbers(names: str, values: tuple[float, ...]) -> str:
        named = zip(names, values, strict=True)
        return "".join(f'<{name} type="Float">{float(value)!r}</{name}>' for name, value in named)

    axes = "".join(f'<cartesian{axis} type="Float"/>' for axis in "XYZ")
    return (
        f'<vectorChild type="Structure"><guid type="String">{k}</guid><pose type="Structure">'
        f'<rotation type="Structure">{numbers("wxyz", rotation)}</rotation>'
        f'<translation type="Structure">{numbers("xyz", translation)}</translation></pose>'
        f'<points type="CompressedVector" fileOffset="{offset}" recordCount="{len(points)}">'
        f'<prototype type="Structure">{axes}</prototype>'
        '<codecs type="Vector" allowHeterogeneousChildren="1"/></points></vectorChild>'
    )


def _crc32c(data: bytes) -> int:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (_REVERSED_POLYNOMIAL if value & 1 else 0)
        table.append(value)
    crc = 0xFFFFFFFF
    for byte in data:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF
