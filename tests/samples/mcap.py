"""MCAP files as other writers make them: any profile, encoding, schema and index."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

Channel = tuple[str, str, str, bytes, str]
"""Topic, encoding of messages, name of the schema, its text, and its encoding."""


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def write_mcap(
    path: Path,
    channels: Sequence[Channel],
    messages: Sequence[tuple[int, int, bytes]],
    *,
    profile: str = "ros2",
    chunked: bool = False,
) -> Path:
    """Write messages, each with the number of its channel and its time [ns].

    A chunked file has an index of chunks, but none of the messages in them.
    """
    heads = b""
    for k, (topic, encoding, name, schema, kind) in enumerate(channels, 1):
        body = struct.pack("<H", k) + _text(name) + _text(kind)
        heads += _record(3, body + struct.pack("<I", len(schema)) + schema)
        body = struct.pack("<HH", k, k) + _text(topic) + _text(encoding)
        heads += _record(4, body + struct.pack("<I", 0))
    bodies = b"".join(
        _record(5, struct.pack("<HIQQ", channel + 1, k, time, time) + data)
        for k, (channel, time, data) in enumerate(messages)
    )
    times = [time for _, time, _ in messages]
    first, last = min(times), max(times)
    data = b"\x89MCAP0\r\n" + _record(1, _text(profile) + _text("segloc"))
    chunk = b""
    if chunked:
        inner = heads + bodies
        start = len(data)
        body = struct.pack("<QQQI", first, last, len(inner), 0) + _text("")
        data += _record(6, body + struct.pack("<Q", len(inner)) + inner)
        body = struct.pack("<QQQQIQ", first, last, start, len(data) - start, 0, 0) + _text("")
        chunk = _record(8, body + struct.pack("<QQ", len(inner), len(inner)))
    else:
        data += heads + bodies
    data += _record(15, struct.pack("<I", 0))
    summary = len(data)
    counts = [sum(channel == k for channel, _, _ in messages) for k in range(len(channels))]
    body = struct.pack(
        "<QHIIIIQQI", len(messages), len(channels), len(channels), 0, 0, int(chunked), first, last,
        10 * len(counts),
    )  # fmt: skip
    body += b"".join(struct.pack("<HQ", k, count) for k, count in enumerate(counts, 1))
    data += heads + chunk + _record(11, body)
    path.write_bytes(data + _record(2, struct.pack("<QQI", summary, 0, 0)) + b"\x89MCAP0\r\n")
    return path
