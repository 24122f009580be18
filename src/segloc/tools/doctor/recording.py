"""Examine a recording, and queries that failed: facts, findings and the likely cause."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ... import geometry
from ...errors import DatasetError, SeglocError
from ...frontend.gravity import angle_deg
from ...frontend.local_cloud import Accumulator, LocalCloudConfig
from ...frontend.surfaces import Surfaces, ground_side, shows_ground
from ...frontend.tilt import MIN_TILT_DEG, frame_tilt
from ...localization import Localization
from ...localizer import Localizer
from ...map.segment_map import SegmentMap
from ...proposals.occupancy import nearest_of
from ...system.text import number, quantity
from ...types import Float32, Float64, Recording, Scan, Scanned, as_recording
from ..datasets import RecordedSequence
from ..datasets.inspection import UNUSABLE, Inspection, inspect
from .body_in_view import body_findings
from .finding import Fault, Finding
from .pose_faults import pose_findings
from .revisits import revisit_findings
from .scan_faults import Z_DOWN_REMEDY, level_points, scan_findings

_MOUNTED_DEG = 10.0
"""Median tilt in one direction above which the sensor is taken to be mounted so."""
_SWAYS_DEG = 4.0
_MIN_UPS = 3  # scans that show a mounting: one may stand on a slope
_TILTED_DEG = 3.0
"""In maps tilted by more, levelled scans are found less often, or falsely."""


_Attitude = tuple[str, list[Finding]]


def _attitude_of(recording: Recording, config: LocalCloudConfig, sample: int) -> _Attitude:
    """Return the source of roll and pitch, in one line, and findings on them.

    They are of the poses, or of ``sample`` scans spread over the recording.
    """
    if recording.poses is None:
        return _of_scans(recording, config, sample)
    try:
        tilt = frame_tilt(recording, config)
    except DatasetError:
        return "of the poses", []  # a scan that cannot be read is a problem already
    if tilt is None:
        return "of the poses (too few walls to check them)", []
    text = f"of the poses, whose z axis is {tilt.tilt_deg:.1f} deg off vertical"
    if not tilt.is_significant:
        return text, []
    what = f"the frame of the poses is tilted by {tilt.tilt_deg:.1f} degrees, as walls show"
    wrong = tilt.tilt_deg > _TILTED_DEG
    finding = Finding(Fault.POSES_TILTED, what, "`segloc map build --level` turns it", wrong)
    return text, [finding]


def _of_scans(recording: Recording, config: LocalCloudConfig, sample: int) -> _Attitude:
    accumulator, sources, off = Accumulator(config), Counter[str](), []
    for scan in sample_scans(recording, sample):
        cloud = accumulator.gather(scan)
        sources["gravity" if cloud.attitude == "given" else cloud.attitude] += 1
        if cloud.attitude != "assumed":
            off.append((cloud.T_local_sensor[2, :3], accumulator.level(scan)))
    if not off:
        return "not known: the scans show neither floors nor walls", []
    tilts = [angle_deg(up, level) for up, level in off]
    counts = ", ".join(f"{count} {name}" for name, count in sorted(sources.items()))
    middle, most = float(np.median(tilts)), max(tilts)
    text = f"{counts}; tilt {middle:.1f} deg, at most {most:.1f}"
    findings = []
    if most > 2 * MIN_TILT_DEG:
        findings.append(_tilt_finding(np.array([up for up, _ in off]), middle, most))
    if sources["assumed"]:
        what = (
            f"{sources['assumed']} of {sources.total()} scans show too little of floors and walls "
            "to tell their roll and pitch"
        )
        findings.append(Finding(Fault.TILT, what, "give gravity, or poses", wrong=False))
    return text, findings


def _tilt_finding(ups: np.ndarray, middle: float, most: float) -> Finding:
    """Return the finding on a sensor that sways, or is mounted at an angle."""
    what = f"scans are tilted by {middle:.1f} degrees in the median, {most:.1f} at most"
    mean = ups.mean(axis=0)
    sway = float(np.median([angle_deg(up, mean) for up in ups]))
    if len(ups) >= _MIN_UPS and middle > _MOUNTED_DEG and sway < _SWAYS_DEG:
        remedy = "set how the sensor is mounted, `local_cloud: {mount: {rpy_deg: ...}}`"
        return Finding(Fault.TILT, what, remedy)
    remedy = "each scan is levelled by its floors and walls; gravity or poses are more accurate"
    return Finding(Fault.TILT, what, remedy, wrong=False)


SAMPLE = 20
"""Number of scans read, spread over the recording."""


@dataclass(frozen=True)
class Examination:
    """Facts and findings of a recording."""

    inspection: Inspection
    attitude: str  # source of roll and pitch
    findings: tuple[Finding, ...]  # faults first

    @property
    def healthy(self) -> bool:
        """True if there are no faults."""
        return not any(finding.wrong for finding in self.findings)


def examine(
    recording: RecordedSequence, config: LocalCloudConfig | None = None, sample: int = SAMPLE
) -> Examination:
    """Examine the facts, some scans and the poses of a recording.

    Unreadable scans are listed as findings, not raised.

    Parameters
    ----------
    recording : recording
        As :func:`segloc.tools.datasets.open_sequence` opens it.
    config : LocalCloudConfig, optional
        Mount of the sensor.
    sample : int
        Number of scans to read.
    """
    config = config or LocalCloudConfig()
    facts = inspect(recording, sample)
    posed = recording.poses is not None
    scans = sample_scans(recording, sample)
    seen = scan_findings(scans, config, posed=posed)
    misframed = any(finding.fault in _FRAME_FAULTS for finding in seen)
    # Beams cannot be examined in a wrong frame.
    lines = facts.problems if misframed else (*facts.problems, *facts.sensor_changes)
    notes = set(recording.notes)
    found = [Finding(Fault.READING, line, wrong=line not in notes) for line in lines]
    found += seen + _left_out(facts)
    if not posed and all(finding.fault is not Fault.FEW_BEAMS for finding in found):
        found.append(_NO_POSES)
    text = "not known"
    if not misframed:
        found += body_findings(scans, config)
        text, tilts = _attitude_of(recording, config, sample)
        # Report only the first fault: poses match no scans of a sensor on its side, and misread
        # poses also look tilted.
        sound = not any(finding.wrong for finding in seen)
        posing = pose_findings(recording, config) if sound else []
        if sound and posed and not posing:
            posing = revisit_findings(recording, config)
        if any(finding.fault in _FRAME_FAULTS for finding in posing):
            found = [one for one in found if one.what not in facts.sensor_changes]
        if any(finding.wrong for finding in posing):
            tilts = [one for one in tilts if one.fault is not Fault.POSES_TILTED]
        found += tilts + posing
    order = sorted(found, key=lambda finding: (not finding.wrong, finding.fault is Fault.READING))
    return Examination(facts, text, tuple(order))


def _left_out(facts: Inspection) -> list[Finding]:
    """Report dropped points, unless a problem of the recording counts them."""
    found = []
    counted = any(UNUSABLE in line for line in facts.problems)
    if facts.unusable and not counted:
        what = f"{_percent(facts.unusable)} of the points are {UNUSABLE}: they are dropped"
        found.append(Finding(Fault.UNUSABLE_POINTS, what, wrong=False))
    if facts.missing_returns:
        share = _percent(facts.missing_returns)
        what = f"{share} of the points stand for missing returns, on one spot or at one range"
        remedy = "they are dropped; the driver can drop them, too, or write NaN"
        found.append(Finding(Fault.MISSING_RETURNS, what, remedy, wrong=False))
    return found


def _percent(share: float) -> str:
    return f"{share:.0%}" if share >= 0.01 else f"{100 * share:.1g}%"


_NO_POSES = Finding(
    Fault.NO_POSES,
    "no poses",
    "a map needs poses (--poses FILE, or --odometry), and queries are found more often with them",
    wrong=False,
)
_FRAME_FAULTS = {
    Fault.MILLIMETRES,
    Fault.CENTIMETRES,
    Fault.WORLD_COORDINATES,
    Fault.CAMERA_AXES,
    Fault.Z_DOWN,
}
"""Faults that prevent further checks."""


def first_fault(
    recording: Recording, config: LocalCloudConfig | None = None, sample: int = 5
) -> Finding | None:
    """Return the first fault to fix; None if none is found.

    Faster than :func:`examine`: uses ``sample`` scans and the poses alone.
    """
    return next(iter(_first(recording, sample_scans(recording, sample), config)), None)


def _first(
    recording: Recording, scans: Sequence[Scan], config: LocalCloudConfig | None
) -> list[Finding]:
    """Return the findings of some scans, or else of the poses; faults first."""
    found = scan_findings(scans, config, posed=recording.poses is not None)
    if not any(finding.wrong for finding in found):
        found += pose_findings(recording, config)
    return sorted(found, key=lambda finding: not finding.wrong)


_MAPPABLE = (Fault.POSES_OFF, Fault.ONLY_GROUND, Fault.SINGLE_PLANE)
"""Faults of recordings whose maps are of some use."""


def require_mappable(
    recording: Recording, config: LocalCloudConfig, name: object, insist: str
) -> Finding | None:
    """Reject a recording that would smear a map; return a smaller fault, if there is one.

    Parameters
    ----------
    recording : Recording
        With poses.
    config : LocalCloudConfig
        Mount of the sensor.
    name : object
        Name of the recording in the message.
    insist : str
        What builds the map anyway.

    Raises
    ------
    DatasetError
        With the fault and its remedy.
    """
    finding = first_fault(recording, config)
    if finding is None or not finding.wrong:
        return None
    if finding.fault in _MAPPABLE:
        return finding
    raise DatasetError(f"{name}: {finding}; {insist} builds the map anyway")


def sample_scans(recording: Recording, count: int) -> list[Scan]:
    """Return readable scans spread over a recording."""
    scans = []
    for i in geometry.spread(len(recording), count):
        with suppress(DatasetError):
            scans.append(recording.scan(i))
    return scans


_SAMPLE = 5  # scans examined for a hint
_VIEWS, _VIEW_M = 8, 20.0  # of a map
_TRIALS = 3  # scans that are localized upside down
_HALF_TURN = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_MAX_LOCALIZED = 0.5  # share of localized queries above which no hint is given


def hint(
    scans: Scanned,
    results: Sequence[Localization],
    config: LocalCloudConfig | None = None,
    *,
    prior_map: SegmentMap | None = None,
    known: str | None = None,
) -> str | None:
    """Return one line on why most queries fail; None if most succeed or no cause is known.

    Parameters
    ----------
    scans : Recording, or list of Scan or of (N, >=3) arrays
        The scans of the queries.
    results : list of Localization
    config : LocalCloudConfig, optional
        Mount of the sensor.
    prior_map : SegmentMap, optional
        The map; a tilted frame is also a cause.
    known : str, optional
        Cause known to the caller; no scan is then examined.
    """
    found = sum(result.localized for result in results)
    if found > _MAX_LOCALIZED * len(results):
        return None
    failed = f"{len(results) - found} of {quantity(len(results), 'queries')} failed."
    cause = known or _cause(scans, config, prior_map)
    if cause is not None:
        return f"{failed} Likely cause: {cause}"
    if found:
        return None
    return (
        f"{failed} No problem found in the scans: were they taken within the map? "
        "`segloc explain SCAN --map MAP` shows at which stage they fail"
    )


def _cause(
    scans: Scanned, config: LocalCloudConfig | None, prior_map: SegmentMap | None
) -> str | None:
    """Describe the first problem of the scans, or else of them in the map, or else a remark."""
    try:
        recording = as_recording(scans)
        some = sample_scans(recording, _SAMPLE)
        found = _first(recording, some, config)
    except SeglocError:
        return None
    if prior_map is not None and not any(finding.wrong for finding in found):
        metadata = prior_map.metadata
        is_level = {"T_map_odom", "T_map_cloud"} & metadata.keys()
        if not is_level and (frame := metadata.get("frame")):
            return f"the map's frame is {frame}. Build the map with --level"
        if in_map := map_finding(some, prior_map, config):
            return str(in_map)
    causes = (finding for finding in found if finding.fault is not Fault.NO_GROUND)
    return next(map(str, causes), None)


def map_finding(
    scans: Sequence[Scan], prior_map: SegmentMap, config: LocalCloudConfig | None = None
) -> Finding | None:
    """Return why scans do not fit a map although neither has a fault; None if not known.

    Ground is cut off in one of them, or the scans fit after half a turn about x.

    Parameters
    ----------
    scans : list of Scan
    prior_map : SegmentMap
    config : LocalCloudConfig, optional
        Mount of the sensor.
    """
    clouds = [level_points(scan, config or LocalCloudConfig()) for scan in scans]
    ground, mapped = shows_ground(clouds), shows_ground(_views(prior_map))
    if ground is False and mapped:
        what = "no ground in the scans, but in the map"
        return Finding(Fault.NO_GROUND, what, "keep the points of the ground")
    if ground and mapped is False:
        what = "no ground in the map, but in the scans"
        return Finding(Fault.NO_GROUND, what, "build the map from clouds with their ground")
    return _find_inverted(clouds, prior_map)


def _views(prior_map: SegmentMap) -> list[Float32]:
    """Return the map's cloud around some of its viewpoints."""
    positions = prior_map.trajectory[:, :3, 3]
    views = []
    for i in geometry.spread(len(positions), _VIEWS):
        cloud = prior_map.cloud - (positions[i] - prior_map.origin).astype(np.float32)
        views.append(cloud[(np.abs(cloud[:, :2]) < _VIEW_M).all(axis=1)])
    return views


def _find_inverted(clouds: Sequence[Float32], prior_map: SegmentMap) -> Finding | None:
    """Detect scans that are localized upside down, if their own surfaces do not tell."""
    seen = [each for points in clouds if (each := Surfaces.of(points)) is not None]
    if not seen or ground_side(seen, sure=True) is not None:
        return None
    try:
        localizer = Localizer(prior_map)
    except SeglocError:
        return None
    few = clouds[:: max(1, len(clouds) // _TRIALS)][:_TRIALS]
    turned = [localizer.localize(points * _HALF_TURN).T_map_sensor for points in few]
    # Scans with one axis mirrored may fit the reflection in a floor: too low.
    storey_m, path = localizer.config.pose.separation.height, prior_map.trajectory[:, :3, 3]
    found = sum(T is not None and _height_off(T[:3, 3], path) < storey_m for T in turned)
    if found <= len(few) / 2:
        return None
    what = f"localized upside down: {found} of {quantity(len(few), 'scans')}"
    return Finding(Fault.Z_DOWN, f"{what}, so the z axis points down", Z_DOWN_REMEDY)


def _height_off(position: Float64, path: Float64) -> float:
    """Return how much higher or lower a position is than the nearest of a path [m]."""
    if not len(path):
        return 0.0
    _, nearest = nearest_of(path[:, :2], position[:2])
    return abs(float(position[2] - path[nearest, 2]))


def facts(recording: RecordedSequence, examination: Examination) -> list[tuple[str, str]]:
    """Return the facts about a recording in words, with units."""
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
        ("points per scan, median", f"{found.points} ({quantity(found.sampled, 'scans')} read)"),
        (f"points {UNUSABLE}", f"{100 * found.unusable:.2f} %"),
        ("points that are NaN", f"{100 * found.blank:.2f} %"),
        ("points for missing returns", f"{100 * found.missing_returns:.2f} %"),
        ("problems", str(wrong) if wrong else "none found"),
    ]
