"""``segloc info``"""

from __future__ import annotations

from typing import TYPE_CHECKING

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
    from .doctor import examine_recording, show_pose_files

    recording, found = examine_recording(sequence, poses, select, topic, sample, config)
    show(recording, found)
    if poses is None:
        show_pose_files(sequence, recording)


def show(recording: RecordedSequence, examination: Examination) -> None:
    """Print a recording's facts as a table, followed by its problems."""
    from ..doctor import facts
    from .doctor import show_findings

    table(recording.name, ("", ""), facts(recording, examination))
    show_findings(examination)
