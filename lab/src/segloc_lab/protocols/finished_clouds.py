r"""Scans of months later in a finished cloud of streets and parks without ground.

DATA has `utd_grand_loop`: the cloud, scans, and poses of those that were registered to it. Each is
localized in a map of the cloud as it is, thinned, tilted and levelled by `--level`, or bent, with
viewpoints that are chosen or are the poses of the scans (an upper bound of what a trajectory
brings). Beside the answers: whether a right pose was among the places that were measured. Scans of
other places, `kitti_starts` and some of `kitti00`, without their ground, too, lie in no map.

Maps and answers are kept in WORK, so that a run goes on where the last one ended.

    python -m segloc_lab.protocols.finished_clouds DATA --work WORK --report reports/finished-clouds
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from segloc import Config, Localizer, Scan, SegmentMap, geometry
from segloc.tools.datasets import open_sequence
from segloc.tools.io import clouds
from segloc.types import Float32, Float64, Pose

from .. import kitti00
from ..outcomes import pose_error
from ..recordings import Files
from ..report import Table, earlier, keep, publish, reporting, share

PLAIN, TRAJECTORY, TILTED, BENT = "as it is", "with --trajectory", "tilted, --level", "bent by 1 m"
THINNED = {"thinned to 0.25 m": 0.25, "thinned to 0.5 m": 0.5}
MAPS = (PLAIN, TRAJECTORY, *THINNED, TILTED, BENT)
TILT = geometry.rigid(Rotation.from_euler("xy", [12, 16], degrees=True).as_matrix(), np.zeros(3))
"""By 20 degrees."""
BOW = np.array([0.0, 0.6, 0.8])
"""Shift of the middle of a cloud that is bent, against its ends along x [m]."""
OWN, OTHERS = "of the place", "of other places"
NEAR_M = 3.0
EVERY = 20
"""Every EVERY-th full scan of KITTI 00 is a scan of another place."""
CUT_M = -1.43
"""Height against the sensor of KITTI below which points are cut off: 0.3 m over the ground."""


class Study:
    """Maps of the cloud and the answers in them, kept in a folder."""

    def __init__(self, data: Path, work: Path) -> None:
        root = data / "utd_grand_loop"
        self._data, self._work, self._file = data, work, root / "map.laz"
        self._scans = open_sequence(root / "scans", root / "poses_registered.tum")
        self._truths = kitti00.poses_of(self._scans)
        self._answers = work / "answers.jsonl"
        work.mkdir(parents=True, exist_ok=True)

    @cached_property
    def _cloud(self) -> Float64:
        return np.concatenate(list(clouds.read_cloud(self._file))).astype(np.float64)

    @property
    def answers(self) -> list[dict[str, Any]]:
        """What is kept: an entry per map and set of scans."""
        return earlier(self._answers)

    def run(self, name: str) -> None:
        """Build a map and localize in it, unless done."""
        done = {each["scans"] for each in self.answers if each["map"] == name}
        asked = (OWN, OTHERS) if name == PLAIN else (OWN,)
        if done >= set(asked):
            return
        site = self._map(name)
        localizer = Localizer(site, Config(threads=1))
        for scans in asked:
            if scans not in done:
                own = scans == OWN
                rows = [
                    _localized(localizer, points, truth)
                    for points, truth in (self._own(name, site) if own else self._others())
                ]
                entry = {"map": name, "scans": scans, "viewpoints": len(site.trajectory)}
                keep(self._answers, entry | {"gap_m": self._gap(name, site), "rows": rows})

    def _map(self, name: str) -> SegmentMap:
        """Return the map of an altered cloud, built once."""
        path = self._work / f"{name}.segmap"
        if not path.exists():
            config = Config(threads=1)
            mapping = config.mapping.model_copy(update={"level": name == TILTED})
            config = config.model_copy(update={"mapping": mapping})
            trajectory = self._truths if name == TRAJECTORY else None
            cloud = self._altered(name, self._cloud)
            SegmentMap.from_cloud(cloud, config, trajectory=trajectory).save(path)
        return SegmentMap.load(path)

    def _altered(self, name: str, points: Float64) -> Float64:
        """Return points of the cloud, (N, 3), in a cloud that is altered."""
        if name in THINNED and len(points) > len(self._truths):
            voxels = np.floor(points / THINNED[name])
            return points[np.sort(np.unique(voxels, axis=0, return_index=True)[1])]
        if name == TILTED:
            return geometry.transform(TILT, points)
        if name == BENT:
            low, high = self._cloud[:, 0].min(), self._cloud[:, 0].max()
            bow: Float64 = np.sin(np.pi * (points[:, :1] - low) / (high - low)) * BOW
            return points + bow
        return points

    def _truths_in(self, name: str, site: SegmentMap) -> Float64:
        """Return the poses of the scans in a map."""
        truths = TILT @ self._truths if name == TILTED else self._truths.copy()
        truths[:, :3, 3] = self._altered(name, self._truths[:, :3, 3])
        found: Float64 = site.T_map_cloud @ truths
        return found

    def _gap(self, name: str, site: SegmentMap) -> float:
        """Return the median distance of the scans from the next viewpoint [m]."""
        truths = self._truths_in(name, site)[:, :2, 3]
        return float(np.median(cKDTree(site.trajectory[:, :2, 3]).query(truths)[0]))

    def _own(self, name: str, site: SegmentMap) -> Iterator[tuple[Float32, Pose | None]]:
        for i, truth in enumerate(self._truths_in(name, site)):
            yield self._scans.scan(i).points, truth

    def _others(self) -> Iterator[tuple[Float32, Pose | None]]:
        starts, drive = Files(self._data / "kitti_starts"), kitti00.scans(self._data / "kitti00")
        places = chain(
            (starts.scan(i) for i in range(len(starts))),
            (drive.scan(i) for i in range(0, len(drive), EVERY)),
        )
        for scan in places:
            yield scan.points[scan.points[:, 2] > CUT_M], None


def _localized(localizer: Localizer, points: Float32, truth: Pose | None) -> dict[str, Any]:
    """Localize a scan: what became of it, whether a right pose was measured, and the log-ratio."""
    start = time.process_time()
    found, result = localizer.answer(localizer.describe(Scan(points)))
    ms = round(1e3 * (time.process_time() - start), 1)
    places = found.posterior.places
    right = any(pose_error(place.T_map_local, truth)[0] <= NEAR_M for place in places)
    is_right = pose_error(result.T_map_sensor, truth)[0] <= NEAR_M
    outcome = ("found" if is_right else "false") if result.localized else "refused"
    best = places[0].log_ratio if places else None
    return {"outcome": outcome, "right": right, "log_ratio": best, "ms": ms}


def table(answers: list[dict[str, Any]]) -> Table:
    """Count the answers, by map and set of scans."""
    columns = ("cloud", "viewpoints", "m to the next", "scans", "right pose measured", "found")
    rows = []
    for each in answers:
        outcomes = [row["outcome"] for row in each["rows"]]
        count, own = len(outcomes), each["scans"] == OWN
        right = f"{sum(row['right'] for row in each['rows'])} of {count}" if own else "-"
        found = share(outcomes.count("found"), count) if own else "-"
        false = outcomes.count("false")
        ms = float(np.median([row["ms"] for row in each["rows"]]))
        highest = max(row["log_ratio"] or -np.inf for row in each["rows"])
        rows.append(
            (each["map"], each["viewpoints"], f"{each['gap_m']:.0f}", each["scans"], right, found)
            + (false, f"{highest:.1f}", f"{ms:.0f}")
        )
    note = (
        f"Found and right within {NEAR_M:g} m, for the reference is no better. With --trajectory "
        "viewpoints are at the true poses of the scans: an upper bound. *m to the next*: median "
        "distance of the scans from a viewpoint. Highest log-ratio of any place: 4.6 are accepted."
    )
    return Table((*columns, "false", "highest log-ratio", "ms"), rows, note)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--work", type=Path, default=Path("finished_clouds"))
    options.add_argument("--maps", nargs="*", choices=MAPS, default=MAPS, help="of which clouds")
    args = options.parse_args()
    study = Study(args.data, args.work)
    for name in args.maps:
        study.run(name)
    title = "Scans in a finished cloud without ground"
    publish(args.report, title, table([a for a in study.answers if a["map"] in args.maps]))


if __name__ == "__main__":
    main()
