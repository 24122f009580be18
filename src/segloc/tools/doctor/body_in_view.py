"""Find points on the robot itself: near the sensor, and in the same place while the scene moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from ... import _native, geometry
from ...frontend.local_cloud import Accumulator, Corner, LocalCloudConfig
from ...frontend.segmentation import SegmentationConfig, heights_above_ground
from ...types import Bools, Float32, Scan
from .finding import Fault, Finding

_MIN_SCANS = 6
_MIN_SHARE = 0.005  # of the points of the scans
_CELL_M, _REACH_M, _RIM_M = 0.15, 4.0, 0.5  # grid around the sensor; objects on its rim are scene
_VOXEL_M, _MIN_HEIGHT_M = 0.1, 0.3  # of the points used, and their height above ground
_ALWAYS, _OFTEN, _SOMETIMES = 0.9, 0.5, 0.2  # shares of the scans with a point in a cell
_FAR_M, _FAR_CELL_M = (5.0, 15.0), 0.3  # the scene by which motion is recognised
_AT_REST, _SAME = 0.5, 0.8  # share of the scene that is the same, in this share of the scans
_MARGIN_M = 0.05  # around the cells
_AROUND = np.ones((3, 3, 3), dtype=bool)


def body_findings(scans: Sequence[Scan], config: LocalCloudConfig) -> list[Finding]:
    """Return the finding on points that move with the sensor, with their box; empty if none do.

    Parameters
    ----------
    scans : list of Scan
        Spread over one recording. Nothing is found in few scans, or of a robot at rest.
    config : LocalCloudConfig
        Mount of the sensor, and the box that is dropped already.
    """
    outside = [config.without_body(scan) for scan in scans if len(scan)]
    scans = [scan for scan in outside if len(scan)]
    if config.body is not None and outside and not scans:
        what = f"the box `body`, {[list(corner) for corner in config.body]}, holds all points"
        return [Finding(Fault.BODY_IN_VIEW, what, "give its corners in metres")]
    if len(scans) < _MIN_SCANS or geometry.in_one_plane(max((s.points for s in scans), key=len)):
        return []
    standing = [_standing(scan, config) for scan in scans]
    if _share_at_rest(standing) > _AT_REST:
        return []
    box = _box_of([_objects(points) for points in standing])
    if box is None:
        return []
    low, high = np.array(box)
    inside = [((s.points >= low) & (s.points <= high)).all(axis=1).sum() for s in scans]
    share = sum(inside) / sum(map(len, scans))
    if share < _MIN_SHARE:
        return []
    what = f"{share:.1%} of the points move with the sensor: on the robot, or on somebody beside it"
    corners = [[round(float(metres), 2) for metres in corner] for corner in box]
    remedy = f"drop them in the configuration, `local_cloud: {{body: {corners}}}`"
    return [Finding(Fault.BODY_IN_VIEW, what, remedy, wrong=False, box=box)]


def _standing(scan: Scan, config: LocalCloudConfig) -> Float32:
    """Return the points above ground, thinned, in the sensor's frame."""
    cloud = Accumulator(config).gather(scan)
    points = _native.voxel_grid(cloud.points, _VOXEL_M)
    above = heights_above_ground(points, SegmentationConfig()) > _MIN_HEIGHT_M
    T_sensor_local = geometry.inverse(cloud.T_local_sensor)
    return geometry.transform(T_sensor_local, points[above]).astype(np.float32)


def _share_at_rest(standing: Sequence[Float32]) -> float:
    """Return the share of the distant scene that stays where it is in the sensor's frame."""
    cells = []
    for points in standing:
        off = np.abs(points).max(axis=1, initial=0.0)
        far = points[(off > _FAR_M[0]) & (off < _FAR_M[1])]
        cells.append(np.unique(np.floor(far / _FAR_CELL_M).astype(np.int64), axis=0))
    _, counts = np.unique(np.concatenate(cells), axis=0, return_counts=True)
    if not len(counts):
        return 1.0  # nothing shows motion
    return float(counts[counts >= _SAME * len(standing)].sum() / counts.sum())


def _objects(points: Float32) -> Bools:
    """Return the cells around the sensor of objects that end within the grid."""
    size = round(2 * _REACH_M / _CELL_M) + 1
    cells = np.floor((points + _REACH_M) / _CELL_M).astype(np.int64)
    occupied = np.zeros((size, size, size), dtype=bool)
    occupied[tuple(cells[((cells >= 0) & (cells < size)).all(axis=1)].T)] = True
    labels, count = ndimage.label(occupied, _AROUND)
    rim = round(_RIM_M / _CELL_M)
    inner = labels[rim:-rim, rim:-rim, rim:-rim]
    outer = np.bincount(labels.ravel(), minlength=count + 1) - np.bincount(
        inner.ravel(), minlength=count + 1
    )
    ends = outer == 0
    ends[0] = False
    return np.asarray(ends[labels])


def _box_of(objects: Sequence[Bools]) -> tuple[Corner, Corner] | None:
    """Return the box of the objects that are in the same place in all scans; None if none is."""
    share = np.mean(objects, axis=0)
    nearby = np.mean([ndimage.binary_dilation(each, _AROUND) for each in objects], axis=0)
    always = (nearby >= _ALWAYS) & (share >= _OFTEN)
    labels, count = ndimage.label(always | (share >= _SOMETIMES), _AROUND)
    chosen = np.zeros(count + 1, dtype=bool)
    chosen[labels[always]] = True
    chosen[0] = False
    cells = np.argwhere(chosen[labels])
    if not len(cells):
        return None
    low = cells.min(axis=0) * _CELL_M - _REACH_M - _MARGIN_M
    high = (cells.max(axis=0) + 1) * _CELL_M - _REACH_M + _MARGIN_M
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
