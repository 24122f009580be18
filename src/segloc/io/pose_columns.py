"""Columns of a table of poses, by the names in its first line."""

from __future__ import annotations

import re

TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Of a TUM file, in this order."""
_MOST_COLUMNS = 200
_UNIT = re.compile(r"(\S)\s+(?=[\[(])")  # a unit belongs to the name before it
_TIME_WORDS = frozenset({"t", "time", "timestamp", "timestamps", "stamp", "ts", "sec", "secs"})
_TURN_WORDS = frozenset({"q", "quat", "quaternion", "orientation", "ori", "rot", "rotation"})
_PLACE_WORDS = frozenset(
    {"t", "p", "pos", "position", "trans", "translation", "pose", "field", "rs", "r", "m"}
)
_NANO_WORDS = frozenset({"nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"})
_TIME_UNITS = {
    r"nsec|nano|\bns\b|_ns": 1e-9,
    r"usec|micro|\bus\b|_us": 1e-6,
    r"msec|milli|\bms\b|_ms": 1e-3,
}


def delimiter(line: str) -> str | None:
    """Comma or semicolon if there is one; None for white space."""
    return next((mark for mark in ",;" if mark in line), None)


def is_header(line: str) -> bool:
    """Whether no word of a line is a number."""
    words = line.replace(",", " ").replace(";", " ").split()
    return all(word[:1].isalpha() and word.lower() not in ("nan", "inf") for word in words)


def named_columns(line: str) -> tuple[list[int] | None, float]:
    """Positions of the columns of a TUM file by their names, and the unit of its stamps, seconds.

    A ninth column holds nanoseconds beside whole seconds. None where the line does not name all.
    """
    content = line.strip().lstrip("#%").strip()
    mark = delimiter(content)
    names = content.split(mark) if mark else _UNIT.sub(r"\1", content).split()
    roles = [_role(name) for name in names[:_MOST_COLUMNS]]
    if any(role not in roles for role in TUM):
        return None, 1.0
    stamped = [k for k, name in enumerate(names) if roles[k] == "time" and "stamp" in name.lower()]
    first = (stamped or [roles.index("time")])[0]
    columns = [first, *(roles.index(role) for role in TUM[1:])]
    if "nanoseconds" in roles:
        return [*columns, roles.index("nanoseconds")], 1.0
    time = names[first].lower()
    return columns, next((size for word, size in _TIME_UNITS.items() if re.search(word, time)), 1.0)


def _role(name: str) -> str:
    """What a column is by its name: time, x, y, z, qx, qy, qz, qw, or nothing of these."""
    plain = name.lower().partition("[")[0].partition("(")[0].strip("\"' \t\r")
    parts = [part for part in re.split(r"[^a-z0-9]+", plain) if part]
    if not parts:
        return ""
    axis, words = parts[-1][-1], {*parts[:-1], parts[-1][:-1]} - {""}
    if axis in "xyzw" and words & _TURN_WORDS:
        return f"q{axis}"
    if axis in "xyz" and words <= _PLACE_WORDS:
        return axis
    if parts[-1] in _NANO_WORDS and parts[0] not in _TIME_WORDS:
        return "nanoseconds"
    return "time" if parts[0] in _TIME_WORDS or parts[-1] in _TIME_WORDS else ""
