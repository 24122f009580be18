"""Map files: forged, damaged, and compared."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from segloc.errors import MapFormatError
from segloc.map import file as mapfile
from segloc.map.segment_map import SegmentMap

ARRAYS = (
    "vectors",
    "quality",
    "centroids",
    "sizes",
    "session",
    "stamps",
    "cloud",
    "origin",
    "trajectory",
)
FIELDS = ("descriptor", "fingerprint", "dim", "cloud_voxel", "metadata")


def assert_identical(a: SegmentMap, b: SegmentMap) -> None:
    for name in ARRAYS:
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        if x is not None:
            assert x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes(), name
    assert [getattr(a, f) for f in FIELDS] == [getattr(b, f) for f in FIELDS]


def header_end(data: bytes) -> int:
    return 8 + int.from_bytes(data[:8], "little")


def with_header(data: bytes, change: Callable[[dict[str, Any]], None], *, sign: bool) -> bytes:
    """The file with its header edited, and, if ``sign``, a checksum that agrees with the edit."""
    header = json.loads(data[8 : header_end(data)])
    change(header)
    if sign:
        texts = header["__metadata__"]
        shapes = {k: (v["dtype"], v["shape"]) for k, v in header.items() if k != "__metadata__"}
        texts["checksum"] = mapfile._header_digest(texts, shapes)
    encoded = json.dumps(header).encode()
    return len(encoded).to_bytes(8, "little") + encoded + data[header_end(data) :]


def load_bytes(path: Path, data: bytes) -> SegmentMap:
    path.write_bytes(data)
    return SegmentMap.load(path)


def assert_refused(path: Path, data: bytes, match: str | None = None) -> None:
    with pytest.raises(MapFormatError, match=match) as caught:
        load_bytes(path, data)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
