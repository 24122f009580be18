"""``segloc doctor``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...system.text import quantity
from . import options
from .console import busy

if TYPE_CHECKING:
    from ..datasets import RecordedSequence
    from ..doctor import Examination


def doctor(
    sequence: options.Recording,
    poses: options.Poses = None,
    select: options.Select = None,
    topic: options.Topic = None,
    sample: options.Sample = 20,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also write a page with pictures.", show_default="none"),
    ] = None,
    config: options.ConfigFile = None,
) -> None:
    """Check a recording and suggest fixes; exits 1 if anything is wrong.

    Checks units, axes and tilt of the scans, and whether neighbouring clouds match at the poses.
    """
    from ...system.files import checked_target, write_text

    if html is not None:
        checked_target(html, ".html", ".htm")
    recording, found = examine_recording(sequence, poses, select, topic, sample, config)
    facts, wrong = found.inspection, sum(finding.wrong for finding in found.findings)
    scans = quantity(len(recording), "scans")
    print(f"{recording.name}: {scans}, {facts.sensor}, poses: {facts.poses}")
    show_findings(found)
    if poses is None:
        show_pose_files(sequence, recording)
    if html is not None:
        from ..batch.doctor_page import page

        with busy("Drawing"):
            write_text(
                html, page(recording, found, options.load_config(config, None, 1).local_cloud)
            )
        print(f"{html}: open it in a browser")
    if wrong:
        raise typer.Exit(1)
    print("no problems found")


def examine_recording(
    sequence: Path,
    poses: Path | None,
    select: str | None,
    topic: str | None,
    sample: int,
    config: Path | None,
) -> tuple[RecordedSequence, Examination]:
    """Open and examine a recording."""
    from ..datasets import open_sequence
    from ..doctor import examine
    from .recording import place_of_sensor

    local_cloud = options.load_config(config, None, 1).local_cloud
    T = place_of_sensor(local_cloud.mount)
    recording = open_sequence(sequence, poses, select, topic=topic, T_base_sensor=T)
    with busy("Examining the scans"):
        return recording, examine(recording, local_cloud, sample)


def show_findings(found: Examination) -> None:
    """Print one line per finding."""
    for finding in found.findings:
        print(f"{'problem' if finding.wrong else 'note'}: {finding}")


def show_pose_files(sequence: Path, recording: RecordedSequence) -> None:
    """If a recording has no poses, list files that may hold them."""
    if recording.poses is None:
        for name in pose_files(sequence.resolve()):
            print(f"note: {name} beside the scans may hold their poses: --poses {name}")


def pose_files(sequence: Path) -> list[str]:
    """Return the names of files beside a recording that may hold its poses, for ``--poses``."""
    inside = sorted(sequence.glob("*.tum")) if sequence.is_dir() else []
    beside = [sequence.parent / f"{sequence.name}{end}" for end in (".tum", ".odometry.tum")]
    return [path.name for path in (*inside, *beside) if path.is_file()]
