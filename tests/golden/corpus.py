"""The corpus: simulated places and the queries in them, by group.

A group is a function that yields the name and the record of each of its cases. ``@group`` adds it
to :data:`GROUPS`; its answers are in ``answers/NAME.json``.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from samples import bindings, stems, streams
from samples.plaza import Plaza, PlazaSequence
from scipy.spatial.transform import Rotation

from . import doors
from .doors import Config, Localizer, Prior, Scan, SegmentMap, build_map, geometry
from .records import Query, Record, digest, exact, localized, of_answer, of_map, of_pose

Cases = Iterable[tuple[str, Record]]
THREADS = int(os.environ.get("GOLDEN_THREADS", "1"))
DRIFT = doors.OdometryNoise(drift_m=0.03, drift_deg=0.04, scale=0.01)


@dataclass(frozen=True)
class Group:
    """Cases that are made in one process and stored in one file."""

    cases: Callable[[], Cases]
    quick: bool


GROUPS: dict[str, Group] = {}


def group(name: str, quick: bool = False) -> Callable[[Callable[[], Cases]], Callable[[], Cases]]:
    """Add a group to the corpus; a quick one is also compared by the test suite."""

    def add(cases: Callable[[], Cases]) -> Callable[[], Cases]:
        GROUPS[name] = Group(cases, quick)
        return cases

    return add


def config(method: str = "profile", **update: Any) -> Config:
    """The preset of a method, on the threads that the corpus is made with."""
    return Config.preset(method).model_copy(update={"threads": THREADS, **update})


# --- recordings ------------------------------------------------------------------------------


class Kept:
    """A recording in memory: scans with their poses, all or those at some positions."""

    stamps = None

    def __init__(self, recording: Any, positions: Iterable[int] | None = None) -> None:
        chosen = list(range(len(recording)) if positions is None else positions)
        self.name = "kept"
        self.scans = [recording.scan(i) for i in chosen]
        self.poses = np.asarray(recording.poses)[chosen]
        self.indices = np.asarray(recording.indices)[chosen]

    def __len__(self) -> int:
        return len(self.scans)

    def scan(self, i: int) -> Scan:
        """The scan at position i."""
        return self.scans[i]

    def alone(self, i: int, T_new_sensor: np.ndarray | None = None, step: int = 1) -> Scan:
        """The points of a scan alone, perhaps turned, and one of ``step`` of them."""
        points = self.scans[i].points[::step]
        return Scan(points if T_new_sensor is None else geometry.transform(T_new_sensor, points))

    def window(self, i: int, count: int) -> list[Scan]:
        """At most ``count`` scans up to position i, with their poses."""
        return self.scans[max(0, i + 1 - count) : i + 1]


class Moved(Kept):
    """A kept recording with other poses."""

    def __init__(self, source: Any, poses: np.ndarray) -> None:
        scans = [source.scan(i) for i in range(len(source))]
        self.name, self.poses, self.indices = "moved", poses, source.indices
        self.scans = [Scan(s.points, T_odom_sensor=T) for s, T in zip(scans, poses, strict=True)]


def tilted(roll_deg: float, pitch_deg: float) -> np.ndarray:
    """A turn about the x and y axes."""
    turn = Rotation.from_euler("xy", (roll_deg, pitch_deg), degrees=True).as_matrix()
    return geometry.rigid(turn, np.zeros(3))


# --- queries in simulated worlds --------------------------------------------------------------


@dataclass(frozen=True)
class Place:
    """A small world, a drive that is mapped, and one that is localized."""

    world: Callable[..., doors.World]
    size_m: float
    mapped_by: tuple[str, int]
    queried_by: tuple[str, int]
    length_m: float = 44.0
    seed: int = 3
    storey: int = 0
    options: dict[str, Any] = field(default_factory=dict)

    def drives(self, seed: int, storey: int | None = None) -> list[doors.SimulatedSequence]:
        """The mapped drive and the one to localize, 2 m from scan to scan."""
        make = partial(
            doors.simulate_sessions,
            self.world(seed, size_m=self.size_m, **self.options),
            conditions=[doors.Conditions(), doors.Conditions(foliage=0.6, replaced=0.15)],
            length_m=self.length_m,
            seed=seed,
            storey=self.storey if storey is None else storey,
        )
        sensors = [doors.SENSORS[name](n) for name, n in (self.mapped_by, self.queried_by)]
        return [make(sensor=sensor)[k] for k, sensor in enumerate(sensors)]


SCENES = doors.SCENES
PLACES = {
    "town": Place(SCENES["town"], 130, ("hdl32e", 700), ("os1-64", 512), 60),
    "terraces": Place(SCENES["terraces"], 130, ("hdl64e", 700), ("vlp16", 900)),
    "industrial": Place(SCENES["industrial"], 130, ("os1-128", 400), ("hdl32e", 700)),
    "park": Place(SCENES["park"], 150, ("vlp16", 900), ("vlp16", 900)),
    "car_park": Place(SCENES["car_park"], 130, ("os1-64", 512), ("vlp16", 900)),
    "forest": Place(SCENES["forest"], 100, ("os1-64", 512), ("hdl32e", 700)),
    "meadow": Place(SCENES["meadow"], 110, ("hdl32e", 700), ("vlp16", 900)),
    "mine": Place(SCENES["mine"], 80, ("vlp16", 900), ("mid360", 20_000)),
    "offices": Place(SCENES["offices"], 40, ("mid360", 20_000), ("mid360", 20_000)),
    "building": Place(SCENES["building"], 40, ("vlp16", 900), ("os0-128", 256)),
    "warehouse": Place(SCENES["warehouse"], 60, ("vlp16", 900), ("vlp16", 900)),
    "warehouse-alike": Place(
        doors.warehouse, 60, ("os1-64", 512), ("avia", 4000), options={"repetitive": True}
    ),
    "storeys": Place(
        doors.building, 40, ("vlp16", 900), ("vlp16", 900), options={"own_rooms": True}
    ),
}


@cache
def driven(name: str) -> tuple[Kept, Kept, Kept]:
    """The mapped drive of a place, the one to localize by odometry, and one that is elsewhere."""
    place = PLACES[name]
    mapped, again = place.drives(place.seed)
    if name == "storeys":
        elsewhere = place.drives(place.seed, storey=2)[1]
    else:
        elsewhere = place.drives(place.seed + 1000)[1]
    return Kept(mapped), Kept(again.with_odometry()), Kept(elsewhere, range(8))


def queries(name: str) -> Iterator[Query]:
    """Single scans and accumulated ones, tilted, thinned, near a prior, and of another place."""
    mapped, again, elsewhere = driven(name)
    last = len(again) - 1
    for i in (0, last // 3, 2 * last // 3, last):
        yield Query(f"single {i}", again.alone(i))
    for i in (last // 2, last):
        yield Query(f"accumulated {i}", again.window(i, 10))
    yield Query("tilted", again.alone(2, tilted(11.0, -8.0)))
    yield Query("thinned", again.alone(last // 4, step=4))
    middle = mapped.poses[len(mapped) // 2, :3, 3]
    yield Query("near", again.alone(1), Prior(mapped.poses[0, :2, 3], 25.0))
    yield Query("near, elsewhere", again.alone(1), Prior(middle + [300.0, 0, 0], 20.0))
    yield Query("other place", elsewhere.alone(4))
    yield Query("other place, accumulated", elsewhere.window(7, 8))


def mapped(name: str, method: str = "profile") -> tuple[SegmentMap, str]:
    """The map of a place, and the digest of what it is made of."""
    recording = driven(name)[0]
    return build_map(recording, config(method)), digest([recording.scans])


def in_place(name: str, method: str = "profile") -> Cases:
    """Localize the queries of a place in its map."""
    prior_map, inputs = mapped(name, method)
    yield "map", {"inputs": inputs, **of_map(prior_map)}
    yield from localized(Localizer(prior_map, config(method)), queries(name), inputs)


for _name in PLACES:
    group(f"world-{_name}", quick=_name in ("town", "offices"))(partial(in_place, _name))

METHODS = (
    "dsm",
    "dsm-fq",
    "dsm-nq",
    "esm",
    "esm-fq",
    "esm-nq",
    "geo",
    "nsm",
    "segmap",
    "segmatch-eigen",
    "segmatch-eigen-ethz",
    "segmatch-esf",
)
for _name in METHODS:
    group(f"method-{_name}")(partial(in_place, "town", _name))


@group("swathes")
def _swathes() -> Cases:
    """A push-broom LiDAR, gathered over 15 m."""
    world = SCENES["town"](5, size_m=130.0)
    conditions = [doors.Conditions(), doors.Conditions(foliage=0.5)]
    drives = doors.simulate_sessions(
        world, doors.SENSORS["lms151"](271), conditions, length_m=120.0, spacing_m=0.3, seed=2
    )
    first, second = (Kept(doors.swathes(drive, 15.0)) for drive in drives)
    inputs = digest([first.scans])
    requested = [Query(f"swathe {i}", second.scan(i)) for i in range(len(second))]
    yield from localized(Localizer(build_map(first, config()), config()), requested, inputs)


SETTINGS: dict[str, dict[str, dict[str, Any]]] = {
    "prosac": {"pose": {"estimator": "prosac"}},
    "ransac": {"pose": {"estimator": "ransac"}},
    "consistency": {"pose": {"estimator": "geometric_consistency"}},
    "no fallback": {"occupancy": {"enabled": False}},
    "no refinement": {"verification": {"refine": False}},
    "few neighbours": {"matching": {"neighbours": 3}},
}


@group("settings")
def _settings() -> Cases:
    """The queries of two places by settings that take other paths."""
    for place in ("offices", "industrial"):
        prior_map, inputs = mapped(place)
        for name, sections in SETTINGS.items():
            changed = {
                section: getattr(config(), section).model_copy(update=values)
                for section, values in sections.items()
            }
            localizer = Localizer(prior_map, config(**changed))
            for case, record in localized(localizer, queries(place), inputs):
                yield f"{place}, {name}, {case}", record


@group("refusals", quick=True)
def _refusals() -> Cases:
    """Clouds that show nothing, little, or another place, with and without fallback."""
    plaza, rng = PlazaSequence(Plaza(0)), np.random.default_rng(0)
    prior_map = build_map(plaza, config())
    inputs = digest([plaza.scan(i) for i in range(len(plaza))])
    flat = rng.uniform(-20, 20, (4000, 3)) * [1, 1, 0.001] - [0, 0, 1.8]
    post = rng.uniform(-0.2, 0.2, (300, 3)) + [6, 0, 0] + rng.uniform(0, 2, (300, 1)) * [0, 0, 1]
    whole = plaza.scan(5).points
    other = Plaza(7).scan(geometry.yaw_transform(0.3, (5.0, 9.0, 1.8))).points
    clouds = {
        "empty": np.empty((0, 3)),
        "not finite": np.full((50, 3), np.nan),
        "point": np.ones((1, 3)),
        "ground": flat,
        "post": np.concatenate([flat, post]),
        "part": whole[whole[:, 0] > 12],
        "partly not finite": np.concatenate([whole, np.full((50, 3), np.inf)]),
        "other": other,
        "scaled": 1.2 * whole,
    }
    alone = {"occupancy": config().occupancy.model_copy(update={"enabled": False})}
    for name, each in (("all", config()), ("segments", config(**alone))):
        requested = [Query(f"{name}, {cloud}", Scan(points)) for cloud, points in clouds.items()]
        yield from localized(Localizer(prior_map, each), requested, inputs)


# --- streams ---------------------------------------------------------------------------------


def of_track(track: Any) -> Record:
    """Where a tracker stands."""
    return {
        "status": track.status.name,
        **of_pose("T_map_odom", track.T_map_odom, track.covariance),
        "confidence": track.confidence,
        "views": track.views,
    }


@group("tracker")
def _tracker() -> Cases:
    """A simulated drive, queried by single scans and by accumulated ones."""
    prior_map, inputs = mapped("town")
    drive = driven("town")[1]
    odometry = DRIFT.odometry(drive.poses, np.random.default_rng(5))
    for name, each in (
        ("single", doors.TrackerConfig(every_m=6.0)),
        ("accumulated", doors.TrackerConfig(accumulate=True, every_m=6.0)),
    ):
        tracker = doors.Tracker(Localizer(prior_map, config()), each)
        for i, T in enumerate(odometry):
            scan = drive.alone(i)
            made = {"inputs": digest([inputs, scan, T])}
            yield f"{name} {i}", made | of_track(tracker.update(scan, T))


def of_state(state: Any) -> Record:
    """Where a live robot stands; latency is left out."""
    return {
        "status": state.status.name,
        **of_pose("T_map_odom", state.T_map_odom, state.covariance),
        "T_map_base": exact(state.T_map_base),
        "confidence": state.confidence,
        "views": state.views,
        "answered": state.answered,
        "travelled_m": state.travelled_m,
    }


LIVE = doors.LiveConfig(tracker=doors.TrackerConfig(accumulate=True, every_m=4.0))


@group("live", quick=True)
def _live() -> Cases:
    """A robot that is followed and then carried away; and the same start by threads."""
    plaza = Plaza(0)
    localizer = Localizer(build_map(PlazaSequence(plaza), config("geo")))
    core = doors.LiveCore(localizer, LIVE)
    begun = list(streams.walked(plaza, 6))
    carried = geometry.yaw_transform(2.5, (3.0, -24.0, 0.0))
    later = streams.walked(plaza, 12, begin=(-2.0, 1.0), start_s=106.0, carried=carried, step=1.0)
    for k, (events, _) in enumerate([*begun, *later]):
        inputs = digest([(e.stamp, e.scan, e.T_odom_base) for e in events])
        for j, state in enumerate(streams.feed(core, events)):
            yield f"core {k}.{j}", {"inputs": inputs} | of_state(state)
    states: list[Any] = []
    started = digest([(e.stamp, e.scan, e.T_odom_base) for events, _ in begun for e in events])
    patient = LIVE.model_copy(update={"silent_s": 600.0})  # a busy machine is no silent sensor
    with doors.LiveLocalizer(localizer, patient, on_state=states.append) as live:
        for event in (event for events, _ in begun for event in events):
            if event.scan is None:
                live.add_odometry(event.stamp, event.T_odom_base)
            else:
                live.add_scan(event.scan, event.stamp)
            assert live.flush(60.0)
    for k, state in enumerate(states):
        yield f"threads {k}", {"inputs": started} | of_state(state)


# --- tiles, alignment, loops, landmarks --------------------------------------------------------


@group("tiles")
def _tiles() -> Cases:
    """A map that is cut, and queries in it."""
    prior_map, inputs = mapped("town")
    with tempfile.TemporaryDirectory() as folder:
        doors.cut_tiles(prior_map, folder, size_m=50.0, margin_m=30.0)
        tiles = doors.TiledMap(folder)
        yield "tiles", {"inputs": inputs, "count": len(tiles), **of_map(tiles.coarse())}
        yield from localized(doors.TiledLocalizer(tiles, config()), queries("town"), inputs)


@group("align")
def _align() -> Cases:
    """Two drifting sessions of a plaza and one of another, brought into one frame."""
    walks: list[Any] = []
    for number, (seed, lane, steps) in enumerate(((0, 0.0, 15), (0, 2.0, 15), (7, 0.0, 6))):
        walk = PlazaSequence(Plaza(seed), steps)
        walk.poses[:, 1, 3] += lane
        odometry = DRIFT.odometry(walk.poses, np.random.default_rng(number))
        frame = geometry.yaw_transform(0.7 * number, (50.0 * number, -20.0, 1.0))
        walks.append(Moved(walk, frame @ odometry))
    found = doors.align_sessions(walks, config())
    inputs = digest([[walk.scans, walk.poses] for walk in walks])
    yield "components", {"inputs": inputs, "components": found.components}
    for k, poses in enumerate(found.poses):
        made = {"inputs": inputs, "poses": exact(poses)}
        yield f"session {k}", made | of_pose("last", poses[-1], None)
    for k, loop in enumerate(found.loops):
        made = {"inputs": inputs, "nodes": [loop.target, loop.source], "kind": loop.kind}
        made |= {"accepted": loop.accepted, "inliers": loop.inliers, "shared": loop.shared}
        yield f"loop {k}", made | of_pose("T", loop.T_target_source, loop.covariance)


@group("loops")
def _loops() -> Cases:
    """Two laps on a circle of a plaza, by drifting odometry."""
    radius_m, plaza = 12.0, Plaza(0)
    angles = np.arange(0.0, 160.0, 2.5) / radius_m
    truths = np.stack(
        [
            geometry.yaw_transform(
                a + math.pi / 2, (radius_m * math.cos(a), radius_m * math.sin(a), 1.8)
            )
            for a in angles
        ]
    )
    odometry = DRIFT.odometry(truths, np.random.default_rng(0))
    geo = config("geo")
    geo = geo.model_copy(
        update={"local_cloud": geo.local_cloud.model_copy(update={"window_m": 12.0})}
    )
    settings = doors.LoopConfig(every_m=5.0, part_m=25.0, min_travel_m=40.0, submap_m=8.0)
    detector = doors.LoopDetector(geo, settings)
    for k, (T, moved) in enumerate(zip(truths, odometry, strict=True)):
        scan = plaza.scan(T, posed=False, seed=k)
        for loop in detector.add(scan.points, moved):
            made = {"inputs": digest([scan, moved]), "confidence": loop.confidence}
            yield f"{loop.i} {loop.j}", made | of_pose("T_i_j", loop.T_i_j, loop.covariance)


@group("landmarks", quick=True)
def _landmarks() -> Cases:
    """Stems as they are given, and as they are found in a cloud."""
    stand = stems.stand(1)
    site = stems.surveyed(stand)
    made = {"inputs": exact(stand.positions)}
    localizer = doors.LandmarkLocalizer(site)
    places = [(20, 42, 0.3), (33, 36, 2.0), (55, 45, -2.8)]
    requested = [
        (f"{name} {k}", stems.seen(source, stems.pose(x, y, yaw, tilt), keep=keep, seed=50 + k))
        for k, (x, y, yaw) in enumerate(places)
        for name, source, keep, tilt in (
            ("all", stand, 1.0, 0.0),
            ("half", stand, 0.5, 0.0),
            ("tilted", stand, 1.0, 0.4),
            ("other", stems.stand(2), 1.0, 0.0),
            ("lattice", stems.plantation(), 1.0, 0.0),
        )
    ]
    for name, view in requested:
        found = localizer.localize(view)
        yield name, made | {"view": exact(view.positions)} | of_answer(found)
    sparse = stems.stand(3, 120)
    cloud = stems.visible(stems.cylinders(sparse), sparse, stems.pose(40, 42, 1.0))
    found = doors.find_stems(Scan(cloud).points)
    yield "found", {"inputs": digest(cloud), "count": len(found), "stems": digest(found.positions)}


# --- map files and kernels -------------------------------------------------------------------


def saved(prior_map: SegmentMap) -> Record:
    """The contents of a map, and the digest of its file without the text of its configuration."""
    bare = prior_map.crop((0.0, 0.0), 1e6)
    bare.metadata.clear()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.segmap"
        bare.save(path)
        content = path.read_bytes()
        again = of_map(SegmentMap.load(path))
    return {**of_map(prior_map), "bytes": len(content), "file": digest(content), "loaded": again}


@group("map-files", quick=True)
def _map_files() -> Cases:
    """Maps that are built, merged, brought up to date and compacted."""
    mapping = doors.MappingConfig(compact=doors.CompactConfig(enabled=False))
    plaza, every = PlazaSequence(Plaza(0)), config(mapping=mapping)
    later = PlazaSequence(Plaza(0, objects=50), 12)
    later.poses[:, 1, 3] += 3.0
    inputs = digest([s.scan(i) for s in (plaza, later) for i in range(len(s))])
    made = {
        "geo": build_map(plaza, config("geo")),
        "profile": build_map(plaza, config()),
        "uncompacted": build_map(plaza, every),
        "smallest": build_map(plaza, config(mapping=config().mapping.smallest())),
    }
    made["merged"] = made["profile"].merge(build_map(later, config()))
    made["compacted"] = doors.compacted(made["uncompacted"], doors.CompactConfig())
    made["updated"], counts = doors.update_map(made["uncompacted"], later, every)
    for name, prior_map in made.items():
        yield name, {"inputs": inputs, **saved(prior_map)}
    yield "update", {"inputs": inputs, **asdict(counts)}


@group("kernels", quick=True)
def _kernels() -> Cases:
    """Every function of the native module, on small inputs."""
    for room, names in bindings.ROOMS.items():
        calls = dict(room())
        for name in names:
            call = calls[name]
            inputs = digest(call.arguments)
            output = call.function(**call.arguments)
            yield name, {"inputs": inputs, "output": digest([output, call.arguments])}
