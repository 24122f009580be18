"""Accuracy of localized poses, against a reference registered to the map.

Ground truth of KITTI 00 agrees from pass to pass to about a metre only. So the reference of each
query is its ground truth, moved to where small_gicp aligns the query with the map's cloud at a
finer resolution (0.3 m) than verification does (0.8 m), from all points within 50 m. References
that move farther than 2.5 m, or from another start (0.3 m aside) end elsewhere, are left out and
counted.

    python -m segloc_lab.protocols.accuracy DATA OUT

OUT is a folder that ``kitti00.sh`` has filled.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import small_gicp

from segloc import Config, Localizer, SegmentMap, geometry
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path, query_clouds
from segloc.types import Float32, Float64, Pose

from ..kitti00 import PROTOCOLS, query_set
from ..outcomes import pose_error
from ..report import Table, publish, reporting

VOXEL_M, CORRESPONDENCE_M, RADIUS_M = 0.3, 1.0, 50.0
FARTHEST_M, AGREE_M = 2.5, 0.05
COLUMNS = (
    "run", "queries", "error m, median / 95 %", "degrees, median / 95 %", "without reference",
    "not localized",
)  # fmt: skip
Row = tuple[str | int, ...]


class Reference:
    """Find the pose in a map of clouds with poses known to about a metre.

    Parameters
    ----------
    cloud : (N, 3) float
        Of the map, relative to ``origin``, (3,).
    """

    def __init__(self, cloud: Float32 | Float64, origin: Float64) -> None:
        self._cloud, self._origin = np.asarray(cloud, dtype=np.float64), origin

    def pose(self, points: Float32, T_map_points: Pose) -> Pose | None:
        """Align points; return T_map_points, or None if two starts disagree."""
        T = geometry.rigid(T_map_points[:3, :3], T_map_points[:3, 3] - self._origin)
        near = np.hypot(*(self._cloud[:, :2] - T[:2, 3]).T) < RADIUS_M + 10
        target, tree = small_gicp.preprocess_points(self._cloud[near], VOXEL_M)
        inside = np.hypot(*points[:, :2].T) < RADIUS_M
        source, _ = small_gicp.preprocess_points(points[inside].astype(np.float64), VOXEL_M)
        ends = []
        for aside in (0.0, 0.3):
            start = T @ geometry.yaw_transform(0.0, (aside, aside, 0.0))
            for limit in (2.0 * CORRESPONDENCE_M, CORRESPONDENCE_M):
                result = small_gicp.align(
                    target, source, tree, start, "GICP", max_correspondence_distance=limit
                )
                start = np.array(result.T_target_source)
            ends.append(start)
        if pose_error(ends[1], ends[0])[0] > AGREE_M or pose_error(ends[0], T)[0] > FARTHEST_M:
            return None
        end = geometry.orthonormal(ends[0])
        return geometry.rigid(end[:3, :3], end[:3, 3] + self._origin)


def errors(data: Path, protocol: str, localizer: Localizer, step: int) -> tuple[Float64, int, int]:
    """Return errors [m, deg] of localized queries (N, 2), dropped references, not localized."""
    prior_map, found, out, lost = localizer.prior_map, [], 0, 0
    reference = Reference(prior_map.cloud, prior_map.origin)
    queries = query_set(data, protocol, step)
    assert queries.truths is not None
    path = prior_map.trajectory
    inside = distances_to_path(queries.truths, path) <= COVERAGE_RADIUS_M
    clouds = query_clouds(queries.recording, queries.positions[inside], localizer.config)
    for (cloud, _), truth in zip(clouds, queries.truths[inside], strict=True):
        answer = localizer.localize(cloud)
        if answer.T_map_sensor is None:
            lost += 1
            continue
        T_map_local = reference.pose(cloud.points, truth @ geometry.inverse(cloud.T_local_sensor))
        if T_map_local is None:
            out += 1
            continue
        found.append(pose_error(answer.T_map_sensor, T_map_local @ cloud.T_local_sensor))
    return np.array(found).reshape(-1, 2), out, lost


def cells(data: Path, out: Path, protocol: str, config: Config, step: int) -> Row:
    """Return one protocol as a row of the table."""
    map_name = f"{PROTOCOLS[protocol].map_name}-{config.method}.segmap"
    localizer = Localizer(SegmentMap.load(out / map_name), config)
    off, without, lost = errors(data, protocol, localizer, step)
    if not len(off):
        return protocol, 0, "-", "-", without, lost
    (m, m95), (deg, deg95) = np.percentile(off, [50, 95], axis=0).T
    metres, degrees = f"{m:.3f} / {m95:.3f}", f"{deg:.2f} / {deg95:.2f}"
    return protocol, len(off), metres, degrees, without, lost


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--step", type=int, default=1, help="use every STEP-th query")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    rows = []
    for name in PROTOCOLS:
        if (args.out / f"{name}-{args.method}").is_dir():
            rows.append(cells(args.data, args.out, name, config, args.step))
    note = f"`{args.method}`; queries within map coverage, every {args.step}."
    publish(args.report, "Accuracy on KITTI 00", Table(COLUMNS, rows, note))


if __name__ == "__main__":
    main()
