"""What there is to say of how a recording's sensor stands."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from ..attitude import angle_deg
from ..errors import DatasetError
from ..levelling import NOTICED_DEG, frame_lean
from ..local_cloud import Accumulator, LocalCloudConfig
from ..types import Recording


class Stands(NamedTuple):
    """Where roll and pitch come from, in one line, and what is wrong with them."""

    said: str
    problems: tuple[str, ...] = ()


def attitudes(recording: Recording, config: LocalCloudConfig, sample: int) -> Stands:
    """How the sensor stands, by the poses or by ``sample`` scans spread over the recording."""
    if recording.poses is None:
        return _of_scans(recording, config, sample)
    try:
        lean = frame_lean(recording, config)
    except DatasetError:
        return Stands("of the poses")  # a scan that cannot be read is a problem already
    if lean is None:
        return Stands("of the poses (too few walls to check them)")
    said = f"of the poses, whose z axis is {lean.tilt_deg:.1f} deg off vertical"
    if not lean.noticed:
        return Stands(said)
    problem = (
        f"the frame of the poses is tilted by {lean.tilt_deg:.1f} degrees, as walls show: "
        "`segloc map build --level` turns it"
    )
    return Stands(said, (problem,))


def _of_scans(recording: Recording, config: LocalCloudConfig, sample: int) -> Stands:
    accumulator, sources, tilts = Accumulator(config), Counter[str](), []
    for i in np.unique(np.linspace(0, len(recording) - 1, max(1, sample)).round().astype(int)):
        try:
            scan = recording.scan(int(i))
        except DatasetError:
            continue
        cloud = accumulator.gather(scan)
        sources["gravity" if cloud.attitude == "given" else cloud.attitude] += 1
        if cloud.attitude != "assumed":
            up = cloud.T_local_sensor[2, :3]
            tilts.append(angle_deg(up, accumulator.level(scan)))
    if not tilts:
        return Stands("not known: the scans show neither floors nor walls")
    counts = ", ".join(f"{count} {name}" for name, count in sorted(sources.items()))
    median, most = float(np.median(tilts)), max(tilts)
    said = f"{counts}; tilt {median:.1f} deg, at most {most:.1f}"
    problems = []
    if most > 2 * NOTICED_DEG:
        problems.append(
            f"scans are not level: tilted by {median:.1f} degrees in the median, {most:.1f} at most"
        )
    if sources["assumed"]:
        problems.append(
            f"{sources['assumed']} of {sources.total()} scans show too little of floors and walls "
            "to tell their roll and pitch"
        )
    return Stands(said, tuple(problems))
