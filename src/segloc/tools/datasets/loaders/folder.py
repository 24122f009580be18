"""Folders of scans, one file each, with poses in a file beside them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....errors import DatasetError
from ....types import Float64, Int64
from ...io.scans import field_names, natural_key, scan_suffix, scan_suffixes
from ..clocks import epoch_unit
from ..recorded import FileSource, Found

NAME = "folder of scans"
_TEXT_SUFFIXES = frozenset({".csv", ".txt"})  # also used for poses and lists
_LISTED = 5
_DIGITS = re.compile(r"\d+", re.ASCII)
_PAIR = re.compile(r"(?:.*\D)?(\d+)([._])(\d{1,9})", re.ASCII)
"""Seconds and a fraction, or seconds and nanoseconds."""
_FRACTION_DIGITS = 3  # minimum, for stamps that do not count from 1970
_NANO_DIGITS = 9
_MAX_SECONDS = 9e9  # of which nanoseconds fit 64 bits
_HINTS = {
    ".e57": "export E57 to .laz or .ply, for example by CloudCompare",
    ".rcp": "export it to .laz",
    ".active": "`rosbag reindex` makes a .bag of an unfinished recording",
    ".zip": "unpack it",
    ".gz": "unpack it",
    ".zst": "unpack it",
    ".zstd": "unpack it by `zstd -d`",
}


def find(path: Path, poses: Path | None) -> Found:
    """List the scans of a folder, sorted by name (numbers in names by value: 2 before 10).

    Every file with a suffix that ``read_scan`` knows is a scan, except hidden files
    and the poses; .csv and .txt files only if there are none of other formats. The index of a scan
    is the last number in its name, or else its position. Names that are times (``SEC.NSEC``,
    ``SEC_NSEC``, milli-, micro- or nanoseconds since 1970) give stamps; scans named by two numbers
    are indexed by position.

    ``path`` may also be the file of one scan; ``poses`` is excluded from the scans.
    Raise DatasetError if the folder is missing or has no scans, or two scans have the same number
    or stamp.
    """
    paths, notes = _scan_paths(path, poses)
    indices, stamps = _indices_and_stamps(paths, path)
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(paths)),
        indices=indices,
        stamps=stamps,
        frame="as recorded",
        fields=" ".join(field_names(paths[0])),
        notes=tuple(notes),
        times_sure=False,
    )


def _scan_paths(folder: Path, poses: Path | None) -> tuple[list[Path], list[str]]:
    """Return the files of scans in order, and notes on skipped files."""
    if folder.is_file() and scan_suffix(folder):
        return [folder], []
    if not folder.exists():
        raise DatasetError(f"{folder}: no such folder or file")
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: not a recording of a known format{_suffixes([folder])}; {known_formats()}"
        )
    try:
        files = [path for path in folder.iterdir() if path.is_file()]
        inner = _inner(folder)
    except OSError as error:
        raise DatasetError(f"{folder}: cannot list: {error.strerror or error}") from error
    scans = [
        path
        for path in files
        if scan_suffix(path) and path.name[0] != "." and not (poses and _same(path, poses))
    ]
    others = [path for path in scans if scan_suffix(path) not in _TEXT_SUFFIXES]
    notes = list[str]()
    if (lost := len(scans) - len(others)) > len(others) > 0:
        kinds = ", ".join(sorted({str(scan_suffix(path)) for path in others}))
        notes = [f"{lost} .csv and .txt files left out: scans are those in {kinds}"]
    scans = others or scans
    if not scans or (inner and not others):
        below = f"; scans found in subfolders: {inner}" if inner else f"; {known_formats()}"
        raise DatasetError(
            f"{folder}: no scans of a known format among its {len(files)} files"
            f"{_suffixes(files)}{below}"
        )
    numbered, left_out = _without_sidecars(scans)
    return sorted(numbered, key=lambda path: natural_key(path.name)), [*notes, *left_out]


def known_formats() -> str:
    """List the formats of recordings, for messages."""
    return (
        "supported: bags (.bag .db3 .mcap), captures (.pcap), dataset folders, and scans "
        f"({' '.join(scan_suffixes())})"
    )


def _suffixes(files: Sequence[Path]) -> str:
    """List suffixes of files and how to read them, in brackets."""
    counts = Counter(path.suffix.lower() or "no suffix" for path in files)
    if not counts:
        return ""
    listed = ", ".join(f"{n} {suffix}" for suffix, n in counts.most_common(_LISTED))
    hints = dict.fromkeys(_HINTS[suffix] for suffix in counts if suffix in _HINTS)
    return f" ({'; '.join([listed, *hints])})"


def _inner(folder: Path) -> str:
    """List subfolders that hold scans."""
    names = sorted(
        path.name
        for path in folder.iterdir()
        if path.is_dir()
        and any((scan_suffix(file) or ".txt") not in _TEXT_SUFFIXES for file in path.iterdir())
    )
    return ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")


def _without_sidecars(files: list[Path]) -> tuple[list[Path], list[str]]:
    """Drop files without a number if most others have one: they are tables, or a map."""
    numbered = [path for path in files if _DIGITS.search(_stem(path))]
    if len(numbered) < 2 or len(numbered) <= len(files) // 2:
        return files, []
    left = sorted(path.name for path in files if path not in numbered)
    return numbered, [f"{name} left out: no number in its name" for name in left]


def _same(path: Path, other: Path) -> bool:
    return other.exists() and path.samefile(other)


def _stem(path: Path) -> str:
    return path.name[: -len(scan_suffix(path) or "")]


def _indices_and_stamps(paths: list[Path], folder: Path) -> tuple[Int64, Float64 | None]:
    """Return indices and stamps of scans by their names; sorts ``paths`` by stamp."""
    stamps = _stamps_of_pairs([_stem(path) for path in paths])
    if stamps is not None:
        order = np.argsort(stamps, kind="stable")
        paths[:] = [paths[k] for k in order]
        stamps = stamps[order]
        if (twice := np.flatnonzero(np.diff(stamps) <= 0)).size:
            first, second = paths[twice[0]], paths[twice[0] + 1]
            raise DatasetError(f"{folder}: {first.name} and {second.name} have the same stamp")
        return np.arange(len(paths)), stamps
    indices = np.array(_indices(paths, folder), dtype=np.int64)
    if not (np.diff(indices) > 0).all():  # of a day, a minute: no number of the scan
        return np.arange(len(paths)), None
    unit = epoch_unit(indices.astype(np.float64))
    if unit is None:
        return indices, None
    return indices, np.asarray(indices.astype(np.float64) * unit, dtype=np.float64)


def _stamps_of_pairs(stems: list[str]) -> Float64 | None:
    """Return stamps [s] if all names end in seconds and a fraction or nanoseconds, else None."""
    found = [_PAIR.fullmatch(stem) for stem in stems]
    pairs = [(match[1], match[2], match[3]) for match in found if match is not None]
    if len(pairs) < len(stems) or any(len(whole) > _NANO_DIGITS * 2 for whole, _, _ in pairs):
        return None
    whole = np.array([int(seconds) for seconds, _, _ in pairs], dtype=np.int64)
    lengths = {len(digits) for _, _, digits in pairs}
    unit = epoch_unit(whole.astype(np.float64))
    decimal = all(mark == "." and stem == f"{a}.{b}" for stem, (a, mark, b) in zip(
        stems, pairs, strict=True
    ))  # fmt: skip
    # Digits of equal length, or as Python prints a float, are a fraction; others are a count.
    printed = all(mark == "." for _, mark, _ in pairs) and max(lengths) < _NANO_DIGITS - 1
    fraction = len(lengths) == 1 or printed
    if unit is None and not (decimal and fraction and max(lengths) >= _FRACTION_DIGITS):
        return None
    count = _NANO_DIGITS if max(lengths) > 6 else 6 if max(lengths) > 3 else 3
    digits = [part if fraction else part.zfill(count) for _, _, part in pairs]
    nanos = np.array([int(part.ljust(_NANO_DIGITS, "0")) for part in digits], dtype=np.int64)
    if unit is None and whole.max() >= _MAX_SECONDS:  # a date
        return None
    if unit in (None, 1.0):
        return np.asarray((whole * 10**_NANO_DIGITS + nanos) * 1e-9, dtype=np.float64)
    return np.asarray((whole + nanos * 1e-9) * unit, dtype=np.float64)


def _indices(paths: list[Path], folder: Path) -> list[int]:
    """Return the last number in each name that is not the same in all, as of a sensor."""
    seen: dict[int, Path] = {}
    found = [_DIGITS.findall(_stem(path)) for path in paths]
    columns = list(zip(*found, strict=False)) if len({*map(len, found)}) == 1 else []
    differ = [k for k, column in enumerate(columns) if len({*map(int, column)}) == len(paths)]
    last = differ[-1] if differ else -1
    for position, (path, numbers) in enumerate(zip(paths, found, strict=True)):
        index = int(numbers[last]) if numbers else position
        if index > np.iinfo(np.int64).max:
            raise DatasetError(f"{path}: the number in its name is too large")
        if index in seen:
            raise DatasetError(
                f"{folder}: {seen[index].name} and {path.name} are both scan {index}; keep one "
                "recording a folder, with its scans numbered"
            )
        seen[index] = path
    return list(seen)
