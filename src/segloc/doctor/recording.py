"""A recording examined: its facts, and all that is found wrong with it."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from .. import geometry
from ..datasets.inspection import UNUSABLE, Inspectable, Inspection, inspect
from ..errors import DatasetError
from ..frontend.gravity import angle_deg
from ..frontend.local_cloud import Accumulator, LocalCloudConfig
from ..frontend.tilt import NOTICED_DEG, frame_lean
from ..types import Recording, Scan
from .finding import Fault, Finding
from .pose_faults import pose_findings
from .scan_faults import scan_findings

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
    for scan in sampled(recording, sample):
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


SAMPLE = 20
"""Scans that are read, spread over the recording."""


@dataclass(frozen=True)
class Examination:
    """What a recording is, and what is wrong with it."""

    inspection: Inspection
    attitude: str  # where roll and pitch come from
    findings: tuple[Finding, ...]  # what is wrong comes first

    @property
    def healthy(self) -> bool:
        """Whether nothing is wrong."""
        return not any(finding.wrong for finding in self.findings)


class Examinable(Recording, Inspectable, Protocol):
    """A recording that can be inspected."""


def examine(
    recording: Examinable, config: LocalCloudConfig | None = None, sample: int = SAMPLE
) -> Examination:
    """Look at a recording's facts, at some of its scans, and at its poses.

    Scans that cannot be read are among the findings, not raised.

    Parameters
    ----------
    recording : recording
        As :func:`segloc.datasets.open_sequence` opens it.
    config : LocalCloudConfig, optional
        How the sensor is mounted.
    sample : int
        How many scans to read.
    """
    config = config or LocalCloudConfig()
    facts = inspect(recording, sample)
    posed = recording.poses is not None
    seen = scan_findings(sampled(recording, sample), config, posed=posed)
    misframed = any(finding.fault in _FRAME_FAULTS for finding in seen)
    # Where frames are wrong, beams are not where a sensor would have them.
    lines = facts.problems if misframed else (*facts.problems, *facts.sensor_changes)
    notes = set(recording.notes)
    found = [Finding(Fault.READING, line, wrong=line not in notes) for line in lines]
    found += seen + _left_out(facts)
    if not posed and all(finding.fault is not Fault.FEW_BEAMS for finding in found):
        found.append(_NO_POSES)
    said = "not known"
    if not misframed:
        stands = attitudes(recording, config, sample)
        said = stands.said
        # What is first to be mended is said alone: poses fit no scans that lie on their side, and
        # poses that are misread are tilted, too.
        sound = not any(finding.wrong for finding in seen)
        posing = pose_findings(recording, config) if sound else []
        misread = any(finding.wrong for finding in posing)
        leaning = [one for one in stands.findings if one.fault is not Fault.POSES_TILTED]
        found += [*(leaning if misread else stands.findings), *posing]
    order = sorted(found, key=lambda finding: (not finding.wrong, finding.fault is Fault.READING))
    return Examination(facts, said, tuple(order))


def _left_out(facts: Inspection) -> list[Finding]:
    """Points that are left out of scans, where no problem of the recording counts them."""
    found = []
    counted = any(UNUSABLE in line for line in facts.problems)
    if facts.dropped and not counted:
        what = f"{_percent(facts.dropped)} of the points are {UNUSABLE}: they are left out"
        found.append(Finding(Fault.UNUSABLE_POINTS, what, wrong=False))
    if facts.missing_returns:
        share = _percent(facts.missing_returns)
        what = f"{share} of the points stand for missing returns, on one spot or at one range"
        remedy = "they are left out; the driver can leave them out, too, or write NaN"
        found.append(Finding(Fault.MISSING_RETURNS, what, remedy, wrong=False))
    return found


def _percent(share: float) -> str:
    return f"{share:.0%}" if share >= 0.01 else f"{100 * share:.1g}%"


_NO_POSES = Finding(
    Fault.NO_POSES,
    "no poses",
    "a map needs some (--poses FILE, or --odometry), and queries are found more often with them",
    wrong=False,
)
_FRAME_FAULTS = {
    Fault.MILLIMETRES,
    Fault.CENTIMETRES,
    Fault.WORLD_COORDINATES,
    Fault.CAMERA_AXES,
    Fault.Z_DOWN,
}
"""Where points are like this, nothing can be said of what depends on them."""


def first_fault(
    recording: Recording, config: LocalCloudConfig | None = None, sample: int = 5
) -> Finding | None:
    """What must be mended first before anything can be expected to work; None if nothing is known.

    Faster than :func:`examine`: by ``sample`` scans and the poses alone.
    """
    posed = recording.poses is not None
    found = scan_findings(sampled(recording, sample), config, posed=posed)
    if not any(finding.wrong for finding in found):
        found += pose_findings(recording, config)
    return next(iter(sorted(found, key=lambda finding: not finding.wrong)), None)


def sampled(recording: Recording, count: int) -> list[Scan]:
    """Scans spread over a recording, without those that cannot be read."""
    scans = []
    for i in geometry.spread(len(recording), count):
        with suppress(DatasetError):
            scans.append(recording.scan(i))
    return scans
