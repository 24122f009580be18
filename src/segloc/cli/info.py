"""``segloc info``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import ConfigFile, Poses, Recording, Select, Topic, load_config

if TYPE_CHECKING:
    from ..datasets.inspection import Inspectable, Inspection


def info(
    sequence: Recording,
    poses: Poses = None,
    select: Select = None,
    topic: Topic = None,
    sample: Annotated[int, typer.Option(min=1, help="How many scans to read.")] = 20,
    config: ConfigFile = None,
) -> None:
    """Show what a recording is and what is wrong with it."""
    from dataclasses import replace
    from typing import cast

    from ..datasets import open_sequence
    from ..datasets.inspection import Inspectable, inspect
    from .attitudes import attitudes
    from .recording import place_of_sensor

    local_cloud = load_config(config, None, 1).local_cloud
    T = place_of_sensor(local_cloud.mount)
    opened = open_sequence(sequence, poses, select, topic=topic, T_base_sensor=T)
    recording = cast(Inspectable, opened)
    found = inspect(recording, sample)
    stands = attitudes(opened, local_cloud, sample)
    show(recording, replace(found, problems=(*found.problems, *stands.problems)), stands.said)
    sequence = sequence.resolve()
    if recording.poses is None and poses is None:
        for name in pose_files(sequence):
            print(f"- {name} beside the scans may be their poses: --poses {name}")


def show(recording: Inspectable, found: Inspection, attitude: str) -> None:
    """Print a recording's facts as one table, and its problems below."""
    from .console import number, table

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
        ("roll and pitch", attitude),
        ("points of a scan, median", f"{found.points} ({found.sampled} scans read)"),
        ("points not finite", f"{100 * found.dropped:.2f} %"),
        ("problems", str(len(found.problems)) if found.problems else "none found"),
    ]
    table(recording.name, ("", ""), rows)
    for line in found.problems:
        print(f"- {line}")


def pose_files(sequence: Path) -> list[str]:
    """Files that ``--poses`` finds by their names alone and that may be a recording's poses."""
    inside = sorted(sequence.glob("*.tum")) if sequence.is_dir() else []
    beside = [sequence.parent / f"{sequence.name}{end}" for end in (".tum", ".odometry.tum")]
    return [path.name for path in (*inside, *beside) if path.is_file()]
