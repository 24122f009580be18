r"""Finished clouds as they come: without ground, thinned, tilted, bent, older than the scans.

DATA has `utd_grand_loop`: a cloud of streets and parks without ground, scans of months later
without theirs, and poses of those that were registered to it. Clouds of recordings stand beside it:
the corridor, whose way back is localized; a session of the lab, for those of other days; KITTI 00,
for another pass; and simulated courtyards with trees, each mapped by three robots whose poses lean
and drift, for a later drive of a fourth. Each scan is localized in a map of the cloud as it is,
thinned, tilted and levelled by `--level`, bent, leaning, or without ground, with viewpoints that
are chosen or are the poses of the scans (an upper bound of what a trajectory brings), and in the
map of the recording, with its true poses. Beside the answers: whether a right pose was among the
places that were measured. Scans of other places, `kitti_starts` and some of `kitti00` without their
ground, lie in no map.

Maps and answers are kept in WORK, so that a run goes on where the last one ended.

    python -m segloc_lab.protocols.finished_clouds DATA --work WORK --report reports/finished-clouds
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.tools.batch import distances_to_path
from segloc.tools.datasets import open_sequence
from segloc.tools.io import clouds
from segloc.types import Float64, Pose

from .. import kitti00
from ..calibration.worlds import AZIMUTHS, LATER
from ..outcomes import TOLERANCE
from ..recordings import Files, one_a_voxel, posed, with_poses
from ..report import Cell, Table, earlier, keep, publish, reporting, share
from ..simulation import SCENES, SENSORS, Conditions, simulate_sessions
from . import real

CAMPUS, KITTI = "campus", "kitti"
COURTS = {f"courtyard {seed}": seed for seed in range(73_000, 73_004)}
"""Seeds in which nothing was chosen."""
SITES = (CAMPUS, "corridor", "lab", KITTI, *COURTS)
PLAIN, TRAJECTORY, CUT, BENT = "as it is", "with --trajectory", "without ground", "bent by 1 m"
LEANING, RECORDING = "leaning by up to 6 degrees", "the recording's own map"
THINNED = {f"thinned to {metres} m": metres for metres in (0.1, 0.25, 0.5)}
TILTED = {
    f"tilted by {degrees} degrees, --level": geometry.rigid(
        Rotation.from_euler("xy", angles, degrees=True).as_matrix(), np.zeros(3)
    )
    for degrees, angles in ((5, (3, 4)), (20, (12, 16)), (37, (20, 31.7)))
}
"""Motions of the cloud."""
MAPS = (RECORDING, PLAIN, TRAJECTORY, CUT, *THINNED, *TILTED, BENT, LEANING)
BOW = np.array([0.0, 0.6, 0.8])
"""Shift of the middle of a cloud that is bent, against its ends along x [m]."""
LEAN_DEG = 6.0
"""Slope of the ends of a cloud that leans, along x."""
ROBOTS = ("hdl64e", "os1-64", "vlp16")
DRIFT_M, DRIFT_DEG = 0.3, 1.0
"""Standard deviations of the poses of a robot in the middle of its way."""
OWN, OTHERS = "of the place", "of other places"
NEAR_M = 3.0
EVERY = 20
"""Every EVERY-th full scan of KITTI 00 is a scan of another place."""
CUT_M = -1.43
"""Height against the sensor of KITTI below which points are cut off: 0.3 m over the ground."""
SQUARE_M, GROUND_M = 4.0, 0.3
"""Squares of a cloud, and the height over the lowest point of each that counts as ground."""
STEP = 3
"""Every STEP-th scan of KITTI 00 and of the lab is localized."""


@dataclass(frozen=True)
class Site:
    """A finished cloud, and scans in it.

    Attributes
    ----------
    cloud : (N, 3) float64
    scans : sequence of Scan
        Without poses.
    truths : (M, 4, 4) float64
        Their poses in the cloud's frame.
    recording : sequence of Scan
        What the cloud was made of, with true poses; empty if that is lost.
    """

    cloud: Float64
    scans: Sequence[Scan]
    truths: Float64
    recording: Sequence[Scan] = ()

    def altered(self, name: str, points: Float64) -> Float64:
        """Return points of the site, (N, 3), where they are in a cloud that is altered."""
        if name in TILTED:
            return geometry.transform(TILTED[name], points)
        if name in (BENT, LEANING):
            low, high = self.cloud[:, 0].min(), self.cloud[:, 0].max()
            rise = (high - low) / np.pi * math.tan(math.radians(LEAN_DEG))
            most = BOW if name == BENT else np.array([0.0, 0.0, rise])
            bow: Float64 = np.sin(np.pi * (points[:, :1] - low) / (high - low)) * most
            return points + bow
        return points

    def altered_cloud(self, name: str) -> Float64:
        """Return the altered cloud."""
        if name in THINNED:
            return one_a_voxel(self.cloud, THINNED[name])
        if name == CUT:
            squares = np.floor(self.cloud[:, :2] / SQUARE_M)
            square = np.unique(squares, axis=0, return_inverse=True)[1].ravel()
            lowest = np.full(square.max() + 1, np.inf)
            np.minimum.at(lowest, square, self.cloud[:, 2])
            stands = np.flatnonzero(self.cloud[:, 2] > lowest[square] + GROUND_M)
            return self.cloud.take(stands, axis=0)
        return self.altered(name, self.cloud)

    def truths_in(self, name: str, prior_map: SegmentMap) -> Float64:
        """Return the poses of the scans in a map of the altered cloud."""
        truths = TILTED.get(name, np.eye(4)) @ self.truths
        truths[:, :3, 3] = self.altered(name, self.truths[:, :3, 3])
        found: Float64 = prior_map.T_map_cloud @ truths
        return found


def site_of(name: str, data: Path) -> Site:
    """Read a site."""
    if name == CAMPUS:
        root = data / "utd_grand_loop"
        scans = open_sequence(root / "scans", root / "poses_registered.tum")
        cloud = np.concatenate(list(clouds.read_cloud(root / "map.laz"))).astype(np.float64)
        alone = [Scan(scans.scan(i).points) for i in range(len(scans))]
        return Site(cloud, alone, kitti00.poses_of(scans))
    if name in COURTS:
        return courtyard(COURTS[name])
    mapped = {"corridor": "corridor, out", "lab": "lab, 0618", KITTI: "kitti, later passes"}[name]
    source = real.sources(data)[mapped]
    taken, truths = list[Scan](), list[Pose]()
    for each in real.queries(data, 1):
        if each.place != name or mapped not in each.maps or each.truths is None:
            continue
        if each.name.endswith("single"):
            some = slice(None, None, 1 if name == "corridor" else STEP)
            taken += [Scan(each.recording.scan(int(i)).points) for i in each.positions[some]]
            truths += list(each.truths[some])
    path = kitti00.poses_of(source)
    cloud = np.concatenate(list(posed(source)))
    return Site(cloud, *_near(path, taken, np.array(truths)), list(with_poses(source)))


def courtyard(seed: int) -> Site:
    """Simulate a courtyard with trees, mapped by three robots whose poses drift."""
    drive = partial(simulate_sessions, SCENES["park"](seed, size_m=150.0), length_m=200.0)
    robots = [
        drive(SENSORS[sensor](AZIMUTHS), [Conditions()], seed=seed + k)[0]
        for k, sensor in enumerate(ROBOTS)
    ]
    later = drive(SENSORS["vlp16"](AZIMUTHS), [Conditions(), LATER], seed=seed)[1]
    drifting = (replace(each, poses=drifted(each.truth, seed + k)) for k, each in enumerate(robots))
    taken = [Scan(later.scan(i).points) for i in range(0, len(later), STEP)]
    path = np.concatenate([each.truth for each in robots])
    return Site(
        np.concatenate([part for each in drifting for part in posed(each)]),
        *_near(path, taken, later.truth[::STEP]),
        [scan for each in robots for scan in with_poses(each)],
    )


def drifted(poses: Float64, seed: int) -> Float64:
    """Return the poses of a loop, (N, 4, 4), which shift and lean more and more, and less again."""
    rng = np.random.default_rng([seed, 11])
    most = np.concatenate([rng.normal(size=3) * DRIFT_M, rng.normal(size=3) * DRIFT_DEG])
    amount = np.sin(np.pi * np.linspace(0.0, 1.0, len(poses)))[:, None] * most
    found: Float64 = poses.copy()
    found[:, :3, 3] += amount[:, :3]
    found[:, :3, :3] = (
        Rotation.from_rotvec(amount[:, 3:], degrees=True).as_matrix() @ poses[:, :3, :3]
    )
    return found


def _near(path: Float64, scans: list[Scan], truths: Float64) -> tuple[list[Scan], Float64]:
    """Return the scans near a mapped path, and their poses."""
    gaps = distances_to_path(truths, path)
    near = np.flatnonzero(gaps <= NEAR_M)
    return [scans[k] for k in near], truths.take(near, axis=0)


def others(data: Path) -> Iterator[Scan]:
    """Yield scans without ground of places that are in no cloud but that of KITTI 00."""
    starts, drive = Files(data / "kitti_starts"), kitti00.scans(data / "kitti00")
    places = chain(
        (starts.scan(i) for i in range(len(starts))),
        (drive.scan(i) for i in range(0, len(drive), EVERY)),
    )
    for scan in places:
        yield Scan(scan.points[scan.points[:, 2] > CUT_M])


class Study:
    """Maps of clouds and the answers in them, kept in a folder."""

    def __init__(self, data: Path, work: Path) -> None:
        self._data, self._work = data, work
        self._answers = work / "answers.jsonl"
        work.mkdir(parents=True, exist_ok=True)

    @property
    def answers(self) -> list[dict[str, Any]]:
        """What is kept: an entry per site, map and set of scans."""
        return earlier(self._answers)

    def run(self, place: str, names: Sequence[str]) -> None:
        """Build maps of a site and localize in them, unless done."""
        done = {(e["map"], e["scans"]) for e in self.answers if e["site"] == place}
        asked = [
            (name, scans)
            for name in names
            for scans in ((OWN, OTHERS) if name in (PLAIN, CUT) and place != KITTI else (OWN,))
            if (name, scans) not in done
        ]
        if not asked:
            return
        site = site_of(place, self._data)
        for name, scans in asked:
            prior_map = self._map(place, site, name)
            localizer = Localizer(prior_map, Config(threads=1))
            truths = site.truths_in(name, prior_map)
            own = zip(site.scans, truths, strict=True) if scans == OWN else None
            pairs = own or ((scan, None) for scan in others(self._data))
            rows = [_localized(localizer, scan, truth) for scan, truth in pairs]
            where = truths[:, :2, 3]
            gap = float(np.median(cKDTree(prior_map.trajectory[:, :2, 3]).query(where)[0]))
            entry = {"site": place, "map": name, "scans": scans, "gap_m": gap, "rows": rows}
            keep(self._answers, entry | {"viewpoints": len(prior_map.trajectory)})

    def _map(self, place: str, site: Site, name: str) -> SegmentMap:
        """Return the map of an altered cloud, built once."""
        path = self._work / f"{place}, {name}.segmap"
        config = Config(threads=1)
        if name == RECORDING and not path.exists():
            build_map(list(site.recording), config).save(path)
        if not path.exists():
            mapping = config.mapping.model_copy(update={"level": name in TILTED})
            config = config.model_copy(update={"mapping": mapping})
            trajectory = site.truths if name == TRAJECTORY else None
            cloud = site.altered_cloud(name)
            SegmentMap.from_cloud(cloud, config, trajectory=trajectory).save(path)
        return SegmentMap.load(path)


def _localized(localizer: Localizer, scan: Scan, truth: Pose | None) -> dict[str, Any]:
    """Localize a scan: what became of it, whether a right pose was measured, and the log-ratio."""
    start = time.process_time()
    query = localizer.describe(scan)
    found, result = localizer.answer(query)
    ms = round(1e3 * (time.process_time() - start), 1)
    places = found.posterior.places
    T_local_sensor = query.cloud.T_local_sensor
    right = any(_is_right(place.T_map_local @ T_local_sensor, truth) for place in places)
    is_right = _is_right(result.T_map_sensor, truth)
    outcome = ("found" if is_right else "false") if result.localized else "refused"
    best = places[0].log_ratio if places else None
    return {"outcome": outcome, "right": right, "log_ratio": best, "ms": ms}


def _is_right(estimate: Pose | None, truth: Pose | None) -> bool:
    """Return whether a pose is near the true one and faces the same way; some clouds lean."""
    if estimate is None or truth is None:
        return False
    off = geometry.inverse(truth) @ estimate
    turned_deg = abs(np.degrees(geometry.heading(off)))
    return bool(np.linalg.norm(off[:3, 3]) <= NEAR_M and turned_deg <= TOLERANCE.degrees)


def table(answers: list[dict[str, Any]]) -> Table:
    """Count the answers, by site, map and set of scans."""
    rows: list[dict[str, Cell]] = []
    places = {name: k for k, name in enumerate((*SITES, *MAPS))}
    for each in sorted(answers, key=lambda e: (places[e["site"]], places[e["map"]])):
        outcomes = [row["outcome"] for row in each["rows"]]
        count, own = len(outcomes), each["scans"] == OWN
        ms = float(np.median([row["ms"] for row in each["rows"]]))
        highest = max(row["log_ratio"] or -np.inf for row in each["rows"])
        right = sum(row["right"] for row in each["rows"])
        rows.append(
            {
                "site": each["site"],
                "cloud": each["map"],
                "viewpoints": each["viewpoints"],
                "m to the next": f"{each['gap_m']:.0f}",
                "scans": each["scans"],
                "right pose measured": f"{right} of {count}" if own else "-",
                "found": share(outcomes.count("found"), count) if own else "-",
                "false": f"{outcomes.count('false')} of {count}",
                "highest log-ratio": f"{highest:.1f}",
                "ms": f"{ms:.0f}",
            }
        )
    note = (
        f"Found and right within {NEAR_M:g} m, for the reference of the campus is no better, and "
        f"{TOLERANCE.degrees:g} degrees of heading, for some clouds lean. With "
        "--trajectory viewpoints are at the true poses of the scans: an upper bound. *m to the "
        "next*: median distance of the scans from a viewpoint. Highest log-ratio of any place: 4.6 "
        f"are accepted. Scans of recordings are those within {NEAR_M:g} m of the mapped path, and "
        f"have their ground. Poses of the robots of courtyards are off by {DRIFT_M:g} m and "
        f"{DRIFT_DEG:g} degrees (standard deviation) in the middle of their ways."
    )
    return Table.of(rows, note)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--work", type=Path, default=Path("finished_clouds"))
    options.add_argument("--sites", nargs="*", choices=SITES, default=SITES)
    options.add_argument("--maps", nargs="*", choices=MAPS, default=MAPS, help="of which clouds")
    args = options.parse_args()
    study = Study(args.data, args.work)
    for place in args.sites:
        missing = (RECORDING, CUT) if place == CAMPUS else ()
        study.run(place, [name for name in args.maps if name not in missing])
    title = "Scans in finished clouds as they come"
    chosen = [a for a in study.answers if a["site"] in args.sites and a["map"] in args.maps]
    publish(args.report, title, table(chosen))


if __name__ == "__main__":
    main()
