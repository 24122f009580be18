"""``segloc simulate``"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from segloc.errors import ConfigError

if TYPE_CHECKING:
    from segloc.tools.datasets import Sequence

    from ..simulation import Conditions, SimulatedSequence


FORMATS = ("npy", "npz", "laz", "bin", "pcd", "ply")
SEASONS = {"summer": 1.0, "autumn": 0.5, "winter": 0.0, "spring": 0.7}
"""Share of leaves; by default, later sessions cycle through the seasons."""

_OF_SUITES = {"suite", "scale", "out", "seed", "file_format", "workers"}

T = TypeVar("T")
Scene = Annotated[
    str | None,
    typer.Argument(
        metavar="SCENE",
        help="town, park, meadow, forest, industrial, warehouse, offices, building or mine.",
        show_default="none: --suite",
    ),
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder.", show_default=False)]
Suite = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Instead of a scene: six named test sets.", show_default="none"
    ),
]
Scale = Annotated[
    str, typer.Option(metavar="NAME", help="Size of the suite: small, full or paper.")
]
Sensor = Annotated[str, typer.Option(metavar="NAME", help="Sensor name.")]
Thin = Annotated[int, typer.Option(metavar="COUNT", help="Keep every COUNT-th firing.")]
Platform = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="car, wheeled, legged, quadruped, carried, handheld or drone.",
        show_default="by scene",
    ),
]
Tilt = Annotated[
    tuple[float, float],
    typer.Option(metavar="DEGREES DEGREES", help="Roll and pitch of the sensor on its platform."),
]
Skew = Annotated[bool, typer.Option(help="Move the sensor during a scan.")]
Sessions = Annotated[
    int,
    typer.Option(
        min=1, max=1001, metavar="COUNT", help="Number of sessions; session 0 is the one to map."
    ),
]
Length = Annotated[float, typer.Option(metavar="METRES", help="Length of each session.")]
Spacing = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Distance between scans.",
        show_default="2, or 0.2 for push-broom sensors",
    ),
]
Size = Annotated[
    float | None, typer.Option(metavar="METRES", help="Side of the world.", show_default="by scene")
]
Storey = Annotated[
    int, typer.Option(min=0, metavar="NUMBER", help="Storey of a building to drive through.")
]
Seed = Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Random seed of the world.")]
Season = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Season of later sessions: summer, autumn, winter or spring.",
        show_default="as in session 0",
    ),
]
Foliage = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE", help="Leaves left in later sessions, 0 to 1.", show_default="by season"
    ),
]
Replaced = Annotated[
    float,
    typer.Option(
        metavar="SHARE", help="Share of bins, benches, bushes and the like that is replaced."
    ),
]
Scaffolding = Annotated[
    float, typer.Option(metavar="SHARE", help="Share of buildings with scaffolding.")
]
Swathe = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Accumulate the sweeps of a push-broom LiDAR over this distance.",
        show_default="not accumulated",
    ),
]
FileFormat = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="SUFFIX",
        help="Format of scans: npy, npz, laz, bin, pcd or ply.",
        show_default="npy, or npz with times",
    ),
]
Objects = Annotated[bool, typer.Option("--objects", help="Also write the object id of each point.")]
PlanOption = Annotated[
    bool,
    typer.Option("--plan", help="Also write plan.stl of a building, and plan_deviating.stl."),
]
Workers = Annotated[int, typer.Option(min=1, metavar="COUNT", help="Ray-casting processes.")]


def simulate(
    context: typer.Context,
    scene: Scene = None,
    out: Out = Path("simulated"),
    suite: Suite = None,
    scale: Scale = "small",
    sensor: Sensor = "hdl64e",
    thin: Thin = 1,
    platform: Platform = None,
    tilt: Tilt = (0.0, 0.0),
    skew: Skew = False,
    sessions: Sessions = 2,
    length: Length = 300.0,
    spacing: Spacing = None,
    size: Size = None,
    storey: Storey = 0,
    seed: Seed = 0,
    season: Season = None,
    foliage: Foliage = None,
    replaced: Replaced = 0.15,
    scaffolding: Scaffolding = 0.03,
    swathe: Swathe = None,
    file_format: FileFormat = None,
    objects: Objects = False,
    plan: PlanOption = False,
    workers: Workers = 2,
) -> None:
    """Record drives through a simulated world: folders of scans with exact poses.

    Writes DIR/session_0 and so on, each with poses.tum (the truth) and odometry.tum, and
    DIR/scene.json. Session 0 is the one to map; later ones return in other lanes and directions,
    leave the map, and find other cars, other seasons and some objects replaced. --plan writes the
    building without furniture and glass, for `segloc map from-mesh`.
    """
    from segloc.tools.cli.results import check_folder

    from ..swathes import swathes

    check_folder(out)
    if file_format is not None:
        _check(FORMATS, file_format, "--format")
    suffix = f".{file_format}" if file_format else None
    if (scene is None) == (suite is None):
        raise ConfigError("pass either a scene or, with --suite, a suite of test sets")
    if suite is not None:
        _refuse_what_suites_fix(context)
        _write_suite(suite, scale, seed, out, suffix, workers)
        return
    assert scene is not None
    for wanted, name in ((objects, "--objects"), (skew, "--skew")):
        if wanted and swathe is not None:
            raise ConfigError(f"{name} needs single scans: omit --swathe")
    order = _Order(
        scene, size, seed, storey, sensor, thin, platform, tilt, skew, length, spacing, swathe
    )
    drives = _drives(order, _conditions(sessions, season, foliage, replaced, scaffolding))
    if plan:
        _write_plans(drives[0], out)
    recordings: list[Sequence] = [
        drive if swathe is None else swathes(drive, swathe) for drive in drives
    ]
    for drive, recording in zip(drives, recordings, strict=True):
        _record(recording, out / drive.name, suffix, objects, workers)
    kinds = _kinds(drives) if objects else {}
    described = [_described(drive, len(r)) for drive, r in zip(drives, recordings, strict=True)]
    _write_facts(out, asdict(order) | {"sessions": described}, kinds)
    print(f"sessions of {drives[0].world.name}: {len(drives)}, in {out}")


@dataclass(frozen=True)
class _Order:
    """Parameters of a simulation, as stored in ``scene.json``."""

    scene: str
    size_m: float | None
    seed: int
    storey: int
    sensor: str
    thin: int
    platform: str | None
    tilt_deg: tuple[float, float]
    skew: bool
    length_m: float
    spacing_m: float | None
    swathe_m: float | None


def _check(names: Iterable[str], name: str, what: str) -> None:
    if name not in names:
        raise ConfigError(f"{what} must be one of {', '.join(names)}, not {name!r}")


def _choice(table: dict[str, T], name: str, what: str) -> T:
    _check(table, name, what)
    return table[name]


def _refuse_what_suites_fix(context: typer.Context) -> None:
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if parameter.name not in _OF_SUITES and source is not None and source.name == "COMMANDLINE":
            raise ConfigError(f"{parameter.opts[0]} is fixed by --suite: omit one of them")


def _conditions(
    sessions: int, season: str | None, foliage: float | None, replaced: float, scaffolding: float
) -> list[Conditions]:
    """Return the conditions of each session: summer for the first, then as requested."""
    from ..simulation import Conditions

    if season is not None and foliage is not None:
        raise ConfigError("--season and --foliage exclude each other")
    names = list(SEASONS) if season is None else [season]
    leaves = [_choice(SEASONS, name, "--season") if foliage is None else foliage for name in names]
    later = [Conditions(share, replaced, scaffolding) for share in leaves]
    return [Conditions(), *(later[k % len(later)] for k in range(1, sessions))]


def _drives(order: _Order, plan: list[Conditions]) -> list[SimulatedSequence]:
    from segloc.tools.cli.console import busy

    from ..simulation import PLATFORMS, SCENES, SENSORS, LineLidar, simulate_sessions

    if not 0 < order.length_m < float("inf"):  # checked before a world is built
        raise ConfigError(f"--length must be a positive number of metres, not {order.length_m}")
    make = _choice(SCENES, order.scene, "the scene")
    lidar = _choice(SENSORS, order.sensor, "--sensor")().thinned(order.thin)
    carrier = None
    if order.platform is not None:
        carrier = _choice(PLATFORMS, order.platform, "--platform")()
        carrier = replace(carrier, mount_rpy_deg=(*order.tilt_deg, 0.0))
    elif any(order.tilt_deg):
        raise ConfigError("--tilt needs --platform: it is the sensor's tilt on its platform")
    spacing = order.spacing_m
    if spacing is None:
        spacing = 0.2 if isinstance(lidar, LineLidar) else 2.0
    with busy(f"Building {order.scene} {order.seed}"):
        size = {} if order.size_m is None else {"size_m": order.size_m}
        drives = simulate_sessions(
            make(order.seed, **size),
            lidar,
            plan,
            length_m=order.length_m,
            spacing_m=spacing,
            seed=order.seed,
            platform=carrier,
            skew=order.skew,
            storey=order.storey,
        )
    return [drive.with_odometry() for drive in drives]


def _record(
    recording: Sequence, folder: Path, suffix: str | None, objects: bool, workers: int
) -> None:
    from segloc.tools.cli.console import progress

    from ..simulation import record

    with progress(folder.name) as update:
        record(recording, folder, suffix=suffix, objects=objects, workers=workers, progress=update)


def _described(drive: SimulatedSequence, scans: int) -> dict[str, Any]:
    return {
        "name": drive.name,
        "session": drive.session,
        "scans": scans,
        "conditions": asdict(drive.conditions),
    }


def _kinds(drives: list[SimulatedSequence]) -> dict[str, str]:
    """Return the kind of every object id of the sessions."""
    from ..simulation.objects.mesh import GROUND_ID

    found = {GROUND_ID: "ground"}
    for drive in drives:
        world, k = drive.world, drive.session
        for group in (*world.standing(k, drive.conditions), world.changing(k)):
            found |= group.kinds
    return {str(number): kind for number, kind in sorted(found.items())}


def _write_suite(
    name: str, scale: str, seed: int, out: Path, suffix: str | None, workers: int
) -> None:
    from ..simulation.suites import SUITES

    sets = _choice(SUITES, name, "--suite")
    for test in sets:
        test.session_length_m(scale)  # rejects an unknown scale before the work
    for test in sets:
        recordings = test.sessions(scale, seed=seed)
        for session, recording in recordings.items():
            _record(recording, out / test.name / session, suffix, False, workers)
        facts = {
            "suite": name,
            "set": test.name,
            "kind": test.kind,
            "scene": test.scene,
            "size_m": test.size_m[scale],
            "sensor": test.sensor,
            "platform": test.platform,
            "scale": scale,
            "seed": seed,
            "session_length_m": test.session_length_m(scale),
            "published": {"length_m": test.length_m, "clouds": test.clouds},
            "share_of_length": test.session_length_m(scale) * len(test.tests) / test.length_m,
            "conditions": [asdict(condition) for condition in test.tests],
            "clouds": {session: len(recording) for session, recording in recordings.items()},
        }
        _write_facts(out / test.name, facts, {})
    print(f"{len(sets)} test sets are in {out}")


def _write_plans(drive: SimulatedSequence, folder: Path) -> None:
    """Write the plan of a drive's world, and that of a building that deviates from it."""
    import numpy as np

    from ..simulation.plans import plan_of, write_stl

    plan = plan_of(drive.world)
    folder.mkdir(parents=True, exist_ok=True)
    write_stl(folder / "plan.stl", plan)
    deviating = plan.deviating(np.random.default_rng([drive.world.seed, 90_001]))
    write_stl(folder / "plan_deviating.stl", deviating)


def _write_facts(folder: Path, facts: dict[str, Any], kinds: dict[str, str]) -> None:
    import json

    from segloc import __version__
    from segloc.system.files import replacing

    for name, content in (("scene.json", facts | {"version": __version__}), ("kinds.json", kinds)):
        if content:
            with replacing(folder / name) as file:
                file.write(json.dumps(content, indent=1).encode() + b"\n")
