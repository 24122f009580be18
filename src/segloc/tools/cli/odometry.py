"""``segloc odometry``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...errors import ConfigError
from ...system.text import number
from . import options
from .console import busy, note, progress, table


def odometry(
    sequence: options.Recording,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="POSES.tum", help="Output file of poses.", show_default="beside the recording"
        ),
    ] = None,
    select: options.Select = None,
    topic: options.Topic = None,
    config: options.ConfigFile = None,
) -> None:
    """Compute the poses of a recording from its scans, by KISS-ICP.

    `--odometry` of other verbs uses the file beside a recording if it covers all scans.
    """
    from typing import cast

    from ... import geometry
    from ...system.files import checked_target
    from ...types import Reposed
    from ..datasets import NO_POSES, RecordedSequence
    from ..datasets.odometry import compute_odometry, odometry_path
    from ..doctor import body_findings, pose_findings, sample_scans
    from .recording import BODY_SCANS, open_recording

    if select is not None and out is None:
        raise ConfigError("--select needs --out: the default file holds the odometry of all scans")
    file = (
        checked_target(out, ".tum", ".txt") if out is not None else odometry_path(sequence, topic)
    )
    recording = cast(
        RecordedSequence, open_recording(sequence, Path(NO_POSES), select, topic=topic)
    )
    local = options.load_config(config, None, 1).local_cloud
    with progress("Odometry") as update:
        poses = compute_odometry(recording, file, local.without_body, update).poses
    with busy("Checking scans against poses"):
        faults = pose_findings(Reposed(recording, poses))
        # What moves with the sensor holds the odometry back.
        body = body_findings(sample_scans(recording, BODY_SCANS), local) if faults else []
    for finding in [*faults, *body]:
        note(str(finding))
    travelled = geometry.distance_travelled(poses)[-1]
    apart = float(((poses[-1, :3, 3] - poses[0, :3, 3]) ** 2).sum() ** 0.5)
    rows = [
        ("scans", str(len(poses))),
        ("path", number(travelled, "m", 1)),
        ("end to start", number(apart, "m", 1)),
    ]
    table(str(file), ("", ""), rows)
