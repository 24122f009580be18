"""The corpus: recordings in ``../shared/data``, where they are at hand."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from samples.real import SHARED

from . import doors
from .corpus import GROUPS as GROUPS
from .corpus import Cases, Kept, config, group, tilted
from .records import Query, Record, digest, localized, of_map


def opened(folder: Path, poses: str, select: str | None = None, step: int = 1) -> Kept:
    """Some scans of a folder, in memory."""
    recording = doors.open_sequence(folder, folder.parent / poses, select)
    return Kept(recording, range(0, len(recording), step))


def in_map(source: Kept, queries: Iterable[Query]) -> Cases:
    """Localize queries in the map of a recording."""
    inputs = digest([source.scans, source.poses])
    prior_map = doors.build_map(source, config())
    yield "map", {"inputs": inputs, **of_map(prior_map)}
    yield from localized(doors.Localizer(prior_map, config()), queries, inputs)


def starts(step: int) -> Iterable[Query]:
    """Scans of other drives than KITTI 00."""
    for path in sorted((SHARED / "kitti_starts").glob("*.laz"))[::step]:
        yield Query(f"other drive {path.stem}", doors.read_scan(path))


def kitti00() -> Cases:
    """Keyframes of a first pass, and queries of a second one and of other places."""
    folder = SHARED / "kitti00" / "keyframes"

    def queries() -> Iterable[Query]:
        for name, select, every in (("again", "1414:1600", 8), ("never mapped", "700:860", 16)):
            drive = opened(folder, "keyframes.tum", select)
            for i in range(12, len(drive), every):
                yield Query(f"{name}, accumulated {drive.indices[i]}", drive.window(i, 12))
                if i // every % 2:
                    yield Query(f"{name}, single {drive.indices[i]}", drive.alone(i))
        yield from starts(4)

    yield from in_map(opened(folder, "keyframes.tum", "160:380"), queries())


def kitti00_scans() -> Cases:
    """Full scans in a map of the keyframes of a later pass."""
    folder = SHARED / "kitti00"

    def queries() -> Iterable[Query]:
        scans = opened(folder / "scans", "scans.tum", "180:380", 12)
        for i, number in enumerate(scans.indices):
            yield Query(f"single {number}", scans.alone(i))
            if i % 4 == 1:
                yield Query(f"tilted {number}", scans.alone(i, tilted(17.0, 9.0)))
                yield Query(f"thinned {number}", scans.alone(i, step=8))

    yield from in_map(opened(folder / "keyframes", "keyframes.tum", "1414:1600"), queries())


def corridor() -> Cases:
    """A corridor that is driven back the other way."""
    folder = SHARED / "vlp16_corridor" / "scans"

    def queries() -> Iterable[Query]:
        back = opened(folder, "poses.tum", "82:104")
        for i, number in enumerate(back.indices):
            yield Query(f"single {number}", back.alone(i))
            if i % 4 == 3:
                yield Query(f"accumulated {number}", back.window(i, 8))
                yield Query(f"tilted {number}", back.alone(i, tilted(-14.0, 10.0)))
        narrow = SHARED / "vlp16_narrow_corridor" / "scans"
        aside = doors.open_sequence(narrow, doors.NO_POSES)
        for i in range(0, len(aside), 6):
            yield Query(f"other corridor {i}", aside.scan(i))

    yield from in_map(opened(folder, "poses.tum", "0:74"), queries())


def lab() -> Cases:
    """A laboratory on other days, by a solid-state sensor."""
    root = SHARED / "mid360_lab"

    def queries() -> Iterable[Query]:
        for session, step in (("0622a", 2), ("0622b", 3), ("0622c", 3)):
            day = opened(root / session / "scans", "poses.tum")
            for i in range(0, len(day), step):
                yield Query(f"{session} {day.indices[i]}", day.alone(i))
        day = opened(root / "0622b" / "scans", "poses.tum")
        for i in range(0, len(day), 9):
            yield Query(f"tilted {day.indices[i]}", day.alone(i, tilted(12.0, -7.0)))

    yield from in_map(opened(root / "0618" / "scans", "poses.tum"), queries())


def doctor() -> Cases:
    """What is found wrong with recordings: kinds and numbers."""
    for case, folder, poses in (
        ("corridor", "vlp16_corridor/scans", "vlp16_corridor/poses.tum"),
        ("kitti", "kitti00/scans", "kitti00/scans.tum"),
        ("vlp16", "vlp16", ""),
        ("hdl32e", "hdl32e", ""),
    ):
        file = SHARED / poses if poses else doors.NO_POSES
        recording = doors.open_sequence(SHARED / folder, file)
        scans = [recording.scan(i) for i in range(0, len(recording), 20)]
        yield case, {"inputs": digest(scans)} | findings(recording)


def findings(recording: object) -> Record:
    """Kinds of findings, and the numbers in what they say."""
    found = doors.examine(recording).findings
    numbers = [re.findall(r"-?\d+(?:\.\d+)?", each.what) for each in found]
    return {"kinds": [each.fault.name for each in found], "numbers": numbers}


if SHARED.exists():
    for _cases in (kitti00, kitti00_scans, corridor, lab, doctor):
        group(f"real-{_cases.__name__}")(_cases)
