"""``segloc doctor``"""

from __future__ import annotations

import typer

from .options import ConfigFile, Poses, Recording, Sample, Select, Topic


def doctor(
    sequence: Recording,
    poses: Poses = None,
    select: Select = None,
    topic: Topic = None,
    sample: Sample = 20,
    config: ConfigFile = None,
) -> None:
    """Say what is wrong with a recording, and what mends it; exit status 1 where something is.

    Units, axes and tilt are seen in the scans; poses are judged by how neighbouring clouds fit.
    """
    from .findings import examined, show_findings, show_pose_files

    recording, found = examined(sequence, poses, select, topic, sample, config)
    facts, wrong = found.inspection, sum(finding.wrong for finding in found.findings)
    print(f"{recording.name}: {len(recording)} scans, {facts.sensor}, poses: {facts.poses}")
    show_findings(found)
    if poses is None:
        show_pose_files(sequence, recording)
    if wrong:
        raise typer.Exit(1)
    print("nothing wrong is found")
