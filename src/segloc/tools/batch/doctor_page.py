"""The page of ``segloc doctor --html``: facts and findings, with a picture of each fault."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ... import geometry
from ...errors import DatasetError
from ...frontend.local_cloud import Accumulator, LocalCloudConfig
from ...frontend.segmentation import Segmenter
from ...system.text import quantity
from ...types import Bools, Float32, Scan
from ..datasets import RecordedSequence
from ..doctor import Examination, Finding, facts, faulty_points
from ..doctor.pose_faults import standing
from ..inspect import html
from ..inspect.pictures import (
    DARK,
    GREEN,
    GREY,
    ORANGE,
    RED,
    blank,
    coordinates,
    dots,
    plan,
    png,
    scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_POINTS = 40_000
_WIDTH_IN, _MIN_HEIGHT_IN, _MARGIN_IN, _DPI = 5.0, 1.0, 0.6, 150
_MIN_RADIUS_M, _BODY_RADIUS_M = 6.0, 6.0
_TRIALS = 9  # scans tried, until one can be read
_USUAL = "{} from above and from the side: ground in grey, what stands above it in orange"
_SAME_M = 0.5
"""Distance up to which a point of one scan lies on another scan."""

Layer = tuple[Float32, str, float]
"""Points, their colour, and their size."""


def page(recording: RecordedSequence, found: Examination, config: LocalCloudConfig) -> str:
    """Return one HTML file with the facts and findings of a recording.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    problems = sum(finding.wrong for finding in found.findings)
    name, scan = _example(recording)
    sections = [_section(finding, recording, scan, name, config) for finding in found.findings]
    usual: list[tuple[str, bytes]] = []
    if not problems and len(scan):
        usual = [(_USUAL.format(name), _picture(_usual(scan, config)))]
    known = [(name, text) for name, text in facts(recording, found) if text != "-"]
    return html.document(
        recording.name,
        quantity(problems, "problems") if problems else "no problems found",
        not problems,
        *sections,
        html.pictures(usual),
        f"<h2>Facts</h2>{html.table(known)}",
    )


def _example(recording: RecordedSequence) -> tuple[str, Scan]:
    """Return the name of a scan, and the scan: a readable one, or else an empty one."""
    middle = len(recording) // 2
    spread = geometry.spread(len(recording), _TRIALS)
    for position in sorted(spread, key=lambda position: abs(position - middle)):
        with suppress(DatasetError):
            scan = recording.scan(position)
            if len(scan):
                return f"Scan {recording.indices[position]}", scan
    return "No scan", Scan(np.empty((0, 3), np.float32))


def _section(
    finding: Finding, recording: RecordedSequence, scan: Scan, name: str, config: LocalCloudConfig
) -> str:
    """Return the section of one finding, with a picture if points show it."""
    shown: list[tuple[str, bytes]] = []
    if finding.scans is not None and recording.poses is not None:
        first, second = finding.scans
        a, b = recording.indices[first], recording.indices[second]
        caption = f"Scan {a} (grey) and scan {b} at their poses: red points lie off scan {a}"
        shown = [(caption, _picture(_pair(recording, first, second)))]
    elif (marked := faulty_points(finding, scan, config)).any():
        caption = f"{name} from above and from the side: red points show it"
        radius_m = None if finding.box is None else _BODY_RADIUS_M
        shown = [(caption, _picture(_mark(scan.points, marked), radius_m))]
    title = html.heading(f"{'Problem' if finding.wrong else 'Note'}: {finding.what}")
    remedy = html.paragraphs([f"What helps: {finding.remedy}"] if finding.remedy else [])
    return f"{title}{remedy}{html.pictures(shown)}"


def _usual(scan: Scan, config: LocalCloudConfig) -> list[Layer]:
    scene = Segmenter().segment(Accumulator(config).gather(scan))
    return [(scene.ground, GREY, 4.0), (scene.structure, ORANGE, 1.0)]


def _mark(points: Float32, marked: Bools) -> list[Layer]:
    return [(points[~marked], GREY, 1.0), (points[marked], RED, 2.0)]


def _pair(recording: RecordedSequence, first: int, second: int) -> list[Layer]:
    """Return what stands in two scans, at their poses in the frame of the first."""
    assert recording.poses is not None
    step = geometry.inverse(recording.poses[first]) @ recording.poses[second]
    here, there = (standing(recording.scan(k).points) for k in (first, second))
    there = geometry.transform(step, there).astype(np.float32)
    off = cKDTree(here).query(there, distance_upper_bound=_SAME_M)[0] > _SAME_M
    return [(here, GREY, 1.0), (there[~off], GREEN, 1.0), (there[off], RED, 1.5)]


def _picture(layers: list[Layer], radius_m: float | None = None) -> bytes:
    """Draw points from above, and below that from the side."""
    low, high = _limits(np.concatenate([points for points, *_ in layers]), radius_m)
    spans = high - low
    per_m = _WIDTH_IN / spans[0]
    above, beside = per_m * spans[1], max(_MIN_HEIGHT_IN, per_m * spans[2])
    middle, half = (low[2] + high[2]) / 2, max(beside / per_m / 2, 1e-3)
    figure = blank((_WIDTH_IN + _MARGIN_IN, above + beside + 2 * _MARGIN_IN), _DPI)
    figure.set_layout_engine("constrained")
    upper, lower = figure.subplots(2, 1, height_ratios=(above, beside))
    plan(upper, low[:2], high[:2])
    plan(lower, (low[0], middle - half), (high[0], middle + half))
    for axes, columns, names in (
        (upper, [0, 1], ("x, m", "y, m")),
        (lower, [0, 2], ("x, m", "z, m")),
    ):
        _draw(axes, layers, columns)
        coordinates(axes, names)
    scale(upper)
    return png(figure)


def _draw(axes: Axes, layers: list[Layer], columns: list[int]) -> None:
    for points, color, size in layers:
        thinned = points[:: 1 + len(points) // _MAX_POINTS]
        dots(axes, thinned[:, columns], s=size, color=color)
    axes.plot(0.0, 0.0, marker="+", ms=12, mew=2, color=DARK, zorder=9)


def _limits(points: Float32, radius_m: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of what is drawn: most points, and the sensor."""
    if radius_m is not None:
        points = points[np.abs(points).max(axis=1) < radius_m]
    if not len(points):
        points = np.zeros((1, 3), np.float32)
    low, high = np.percentile(points, [1, 99], axis=0)
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(1.05 * half, (_MIN_RADIUS_M, _MIN_RADIUS_M, 0.0))
    half[:2] = half.max()
    return middle - half, middle + half
