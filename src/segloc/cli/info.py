"""``segloc info``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .options import ConfigFile, Poses, Recording, Sample, Select, Topic

if TYPE_CHECKING:
    from ..diagnosis import Examinable, Examination


def info(
    sequence: Recording,
    poses: Poses = None,
    select: Select = None,
    topic: Topic = None,
    sample: Sample = 20,
    config: ConfigFile = None,
) -> None:
    """Show what a recording is and what is wrong with it."""
    from .doctor import examined

    recording, found = examined(sequence, poses, select, topic, sample, config)
    show(recording, found)
    if poses is None:
        show_pose_files(sequence, recording)


def show(recording: Examinable, examination: Examination) -> None:
    """Print a recording's facts as one table, and below what is wrong with it."""
    from .console import number, table
    from .doctor import show_findings

    found, wrong = examination.inspection, sum(f.wrong for f in examination.findings)
    first, last = int(recording.indices[0]), int(recording.indices[-1])
    rows = [
        ("format", recording.format),
        ("sensor", found.sensor),
        ("frame of points", recording.frame),
        ("fields", recording.fields or "-"),
        ("times of points", "yes" if found.timed else "no"),
        ("scans", f"{len(recording)} ({first} to {last})"),
        ("rate", number(found.rate_hz, "Hz", 1)),
        ("duration", number(found.duration_s, "s", 1)),
        ("poses", found.poses),
        ("path", number(found.length_m, "m", 1)),
        ("roll and pitch", examination.attitude),
        ("points of a scan, median", f"{found.points} ({found.sampled} scans read)"),
        ("points not finite", f"{100 * found.dropped:.2f} %"),
        ("problems", str(wrong) if wrong else "none found"),
    ]
    table(recording.name, ("", ""), rows)
    show_findings(examination)


def show_pose_files(sequence: Path, recording: Examinable) -> None:
    """Where a recording has no poses, print which files may be theirs."""
    if recording.poses is None:
        for name in pose_files(sequence.resolve()):
            print(f"note: {name} beside the scans may be their poses: --poses {name}")


def pose_files(sequence: Path) -> list[str]:
    """Files that ``--poses`` finds by their names alone and that may be a recording's poses."""
    inside = sorted(sequence.glob("*.tum")) if sequence.is_dir() else []
    beside = [sequence.parent / f"{sequence.name}{end}" for end in (".tum", ".odometry.tum")]
    return [path.name for path in (*inside, *beside) if path.is_file()]
