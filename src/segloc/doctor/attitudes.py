"""What there is to say of how a recording's sensor stands."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from ..errors import DatasetError
from ..frontend.gravity import angle_deg
from ..frontend.local_cloud import Accumulator, LocalCloudConfig
from ..frontend.tilt import NOTICED_DEG, frame_lean
from ..types import Recording
from .finding import Fault, Finding

_MOUNTED_DEG = 10.0
"""A sensor that mostly stands so far off level, always the same way, is mounted so."""
_SWAYS_DEG = 4.0
_LEANS_DEG = 3.0
"""In maps that lean more, scans that are levelled by themselves are found less often, or
falsely."""


class Stands(NamedTuple):
    """Where roll and pitch come from, in one line, and what is wrong with them."""

    said: str
    findings: tuple[Finding, ...] = ()


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
    what = f"the frame of the poses is tilted by {lean.tilt_deg:.1f} degrees, as walls show"
    wrong = lean.tilt_deg > _LEANS_DEG
    finding = Finding(Fault.POSES_TILTED, what, "`segloc map build --level` turns it", wrong)
    return Stands(said, (finding,))


def _of_scans(recording: Recording, config: LocalCloudConfig, sample: int) -> Stands:
    accumulator, sources, off = Accumulator(config), Counter[str](), []
    for i in np.unique(np.linspace(0, len(recording) - 1, max(1, sample)).round().astype(int)):
        try:
            scan = recording.scan(int(i))
        except DatasetError:
            continue
        cloud = accumulator.gather(scan)
        sources["gravity" if cloud.attitude == "given" else cloud.attitude] += 1
        if cloud.attitude != "assumed":
            off.append((cloud.T_local_sensor[2, :3], accumulator.level(scan)))
    if not off:
        return Stands("not known: the scans show neither floors nor walls")
    tilts = [angle_deg(up, level) for up, level in off]
    counts = ", ".join(f"{count} {name}" for name, count in sorted(sources.items()))
    middle, most = float(np.median(tilts)), max(tilts)
    said = f"{counts}; tilt {middle:.1f} deg, at most {most:.1f}"
    findings = []
    if most > 2 * NOTICED_DEG:
        findings.append(_tilted(np.array([up for up, _ in off]), middle, most))
    if sources["assumed"]:
        what = (
            f"{sources['assumed']} of {sources.total()} scans show too little of floors and walls "
            "to tell their roll and pitch"
        )
        findings.append(Finding(Fault.TILT, what, "give gravity, or poses", wrong=False))
    return Stands(said, tuple(findings))


def _tilted(ups: np.ndarray, middle: float, most: float) -> Finding:
    """Of a sensor that sways, or of one that is mounted at an angle."""
    what = f"scans are tilted by {middle:.1f} degrees in the median, {most:.1f} at most"
    mean = ups.mean(axis=0)
    sway = float(np.median([angle_deg(up, mean) for up in ups]))
    if middle > _MOUNTED_DEG and sway < _SWAYS_DEG:
        remedy = "name how the sensor is mounted, `local_cloud: {mount: {rpy_deg: ...}}`"
        return Finding(Fault.TILT, what, remedy)
    remedy = "each is levelled by what it shows; gravity or poses level it better"
    return Finding(Fault.TILT, what, remedy, wrong=False)
