"""``segloc info``"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system.text import counted, number
from . import options
from .console import table

if TYPE_CHECKING:
    from ..datasets import RecordedSequence
    from ..doctor import Examination


def info(
    sequence: options.Recording,
    poses: options.Poses = None,
    select: options.Select = None,
    topic: options.Topic = None,
    sample: options.Sample = 20,
    config: options.ConfigFile = None,
) -> None:
    """Show facts about a recording, and its problems."""
    from .doctor import examined, show_pose_files

    recording, found = examined(sequence, poses, select, topic, sample, config)
    show(recording, found)
    if poses is None:
        show_pose_files(sequence, recording)


def facts(recording: RecordedSequence, examination: Examination) -> list[tuple[str, str]]:
    """Return the facts about a recording in words, with units."""
    from ..datasets.inspection import UNUSABLE

    found, wrong = examination.inspection, sum(f.wrong for f in examination.findings)
    first, last = int(recording.indices[0]), int(recording.indices[-1])
    return [
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
        ("points per scan, median", f"{found.points} ({counted(found.sampled, 'scans')} read)"),
        (f"points {UNUSABLE}", f"{100 * found.unusable:.2f} %"),
        ("points that are NaN", f"{100 * found.blank:.2f} %"),
        ("points for missing returns", f"{100 * found.missing_returns:.2f} %"),
        ("problems", str(wrong) if wrong else "none found"),
    ]


def show(recording: RecordedSequence, examination: Examination) -> None:
    """Print a recording's facts as a table, followed by its problems."""
    from .doctor import show_findings

    table(recording.name, ("", ""), facts(recording, examination))
    show_findings(examination)
