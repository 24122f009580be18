"""Limits of the YAML in bags: a ROS 2 bag's metadata, and qualities of service."""

from __future__ import annotations

import re

from ....errors import DatasetError
from ....system.budget import check_bytes

MAX_METADATA_BYTES = 1 << 20
"""Limit of a ROS 2 bag's metadata.yaml, and of a topic's quality-of-service profile in it."""
_MAX_DEPTH = 64
_BRACKETS = re.compile(r"[\[\]{}]")


def check_metadata(text: str, what: str) -> None:
    """Reject YAML that takes minutes to parse: long or deeply nested."""
    check_bytes(len(text), what, MAX_METADATA_BYTES)
    deepest = max((len(line) - len(line.lstrip(" -?")) for line in text.splitlines()), default=0)
    depth = 0
    for mark in _BRACKETS.findall(text):
        depth += 1 if mark in "[{" else -1
        deepest = max(deepest, depth)
    if deepest > _MAX_DEPTH:
        raise DatasetError(f"{what} is nested deeper than {_MAX_DEPTH} levels")
