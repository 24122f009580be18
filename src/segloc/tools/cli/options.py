"""Arguments and options shared by several verbs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ...errors import ConfigError
from .console import note

if TYPE_CHECKING:
    from ...config import Config
    from ...localizer import Localizer
    from ...map.georeference import Georeference
    from ...map.segment_map import SegmentMap
    from ...prior import Prior
    from ...tiles import TiledMap

Value = TypeVar("Value")

Recording = Annotated[
    Path,
    typer.Argument(metavar="SEQUENCE", help="A dataset sequence, a bag, or a folder of scans."),
]
Poses = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Poses, TUM or KITTI; `none`: no poses.", show_default="its own"
    ),
]
Topic = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Topic, sensor or scene, if there are several.",
        show_default="the only one",
    ),
]
Deskew = Annotated[bool, typer.Option(help="De-skew scans whose points have times.")]
Odometry = Annotated[
    bool, typer.Option("--odometry", help="Compute poses from the scans (`segloc odometry`).")
]
Level = Annotated[
    bool, typer.Option("--level", help="Turn the poses so that z is up, by walls in the scans.")
]
Method = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Descriptor of segments.", show_default="profile"),
]
Select = Annotated[
    str | None,
    typer.Option(
        metavar="A:B[,C:D]",
        help="Use only scans with these numbers, A and B included.",
        show_default="all",
    ),
]
PosesOfEach = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        help="Poses, TUM or KITTI: one file for all, or one per sequence.",
        show_default="their own",
    ),
]
SelectOfEach = Annotated[
    list[str] | None,
    typer.Option(
        metavar="A:B[,C:D]",
        help="Use only these scans, A and B included: one list for all, or one per sequence.",
        show_default="all",
    ),
]
Sample = Annotated[
    int, typer.Option(min=1, metavar="COUNT", help="Number of scans to read, spread evenly.")
]
Every = Annotated[
    float | None,
    typer.Option(
        metavar="METRES", help="Use one scan every METRES of travel.", show_default="every scan"
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="YAML file; `segloc config` prints one.",
        show_default="the map's, or that of the method",
    ),
]
Threads = Annotated[
    int,
    typer.Option(
        min=0, metavar="COUNT", help="Threads; 0: all cores. Results do not depend on it."
    ),
]
Workers = Annotated[
    int, typer.Option(min=1, metavar="COUNT", help="Processes, with one thread each.")
]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Run on a Dask cluster, tcp://host:8786; its workers need the same files.",
        show_default="here",
    ),
]
MapOut = Annotated[Path, typer.Option("--out", metavar="MAP.segmap", help="The map to write.")]
Elsewhere = Annotated[
    bool, typer.Option("--elsewhere", help="Allow a session of another place in the same frame.")
]
Unchecked = Annotated[
    bool, typer.Option("--unchecked", help="Write the map even if scans and poses do not fit.")
]
Weights = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Trained weights.", show_default="the shipped ones"),
]
SameWeights = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="File of the map's weights.", show_default="where they were"),
]

Near = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y[,Z[,YAW]]",
        help="Search near this position [m] and heading [deg] only, in the map's frame.",
        show_default="anywhere",
    ),
]
Height = Annotated[
    str | None,
    typer.Option(
        metavar="Z[,TOLERANCE]",
        help="Search at this height of the sensor [m] only, in the map's frame: a storey.",
        show_default="any; tolerance 1.5",
    ),
]
RADIUS_M = 50.0
Radius = Annotated[
    float | None,
    typer.Option(
        metavar="METRES", help="Search radius around --near.", show_default=f"{RADIUS_M:g}"
    ),
]
Anywhere = Annotated[
    bool,
    typer.Option("--anywhere", help="Search the whole map for queries not found near the prior."),
]

Gnss = Annotated[
    bool,
    typer.Option("--gnss", help="Search near the bag's NavSatFix first, then everywhere."),
]
Epsg = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="CODE",
        help="EPSG code of the map's projected frame.",
        show_default="none",
    ),
]
Origin = Annotated[
    str | None,
    typer.Option(metavar="E,N[,H]", help="Map origin in that frame.", show_default="0,0,0"),
]

Truth = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="True poses in the map's frame, to score against.",
        show_default="unknown",
    ),
]
Metres = Annotated[
    float, typer.Option(min=0, metavar="METRES", help="Position error above this counts as false.")
]
Degrees = Annotated[
    float, typer.Option(min=0, metavar="DEGREES", help="Heading error above this counts as false.")
]


def map_name(where: str) -> str:
    """Return the name of a map by its path or URL."""
    return where.rstrip("/").rsplit("/", 1)[-1]


def parsed_prior(
    near: str | None, radius: float, anywhere: bool, height: str | None = None
) -> Prior | None:
    """Parse the prior of --near, --radius and --height."""
    from ...prior import Prior

    known: dict[str, float] = {}
    if height is not None:
        try:
            numbers = [float(part) for part in height.split(",", maxsplit=1)]
        except ValueError as error:
            raise ConfigError(
                f"--height expects Z or Z,TOLERANCE in metres, not {height!r:.60}"
            ) from error
        known = dict(zip(("height_m", "height_tolerance_m"), numbers, strict=False))
    if near is None:
        return Prior(anywhere=anywhere, **known) if known else None
    try:
        x, y, *rest = near.split(",")
        up, yaw = (*rest, "", "")[: max(2, len(rest))]
        position = [float(part) for part in (x, y, up) if part.strip()]
        heading = float(yaw) if yaw.strip() else None
    except ValueError as error:
        raise ConfigError(
            "--near expects X,Y or X,Y,Z in metres, or X,Y,Z,YAW with degrees (Z may be empty), "
            f"not {near!r:.60}"
        ) from error
    return Prior(position, radius, anywhere, heading, **known)


def parsed_georeference(epsg: int | None, origin: str | None) -> Georeference | None:
    """Parse the georeference of --epsg and --origin."""
    from ...map.georeference import Georeference

    if epsg is None:
        if origin is not None:
            raise ConfigError("--origin needs --epsg, the code of its frame")
        return None
    try:
        east, north, *up = [float(part) for part in (origin or "0,0,0").split(",")]
        (height,) = up or [0.0]
    except ValueError as error:
        raise ConfigError(f"--origin expects E,N or E,N,H in metres, not {origin!r:.60}") from error
    return Georeference(epsg, (east, north, height))


def with_level(config: Config, level: bool, where: Georeference | None) -> Config:
    """Return the configuration with --level; its map has no georeference, as its frame changes."""
    mapping = config.mapping.model_copy(update={"level": level or config.mapping.level})
    if mapping.level and where is not None:
        raise ConfigError("--level changes the frame, so --epsg does not apply: omit one")
    return config.model_copy(update={"mapping": mapping})


def load_config(
    path: Path | None, method: str | None, threads: int, weights: Path | None = None
) -> Config:
    """Return the configuration of a verb: file, preset, and options."""
    from ...config import Config

    return _with(Config.load(path, method), threads, weights)


def description_of(prior_map: SegmentMap | TiledMap) -> SegmentMap:
    """Return the map, or of tiles the thin one."""
    from ...map.segment_map import SegmentMap

    return prior_map if isinstance(prior_map, SegmentMap) else prior_map.coarse()


def map_settings(
    prior_map: SegmentMap | TiledMap, path: Path | None, threads: int, weights: Path | None = None
) -> Config:
    """Return the configuration in a file, or else the map's own."""
    from ...config import Config, map_config

    whole = description_of(prior_map)
    config = map_config(whole) if path is None else Config.load(path, whole.descriptor)
    if weights is None and config.weights is not None and not config.weights.exists():
        raise ConfigError(
            f"the map's weights are missing at {config.weights}: pass the file with --weights"
        )
    return _with(config, threads, weights)


def open_localizer(
    prior_map: SegmentMap | TiledMap, path: Path | None, threads: int, weights: Path | None = None
) -> Localizer:
    """Create a localizer in a map, configured by a file or else by the map.

    Notes on the configuration are printed.
    """
    from ...tiles import localizer_in

    localizer = localizer_in(prior_map, map_settings(prior_map, path, threads, weights))
    for line in localizer.notes:
        note(line)
    return localizer


def _with(config: Config, threads: int, weights: Path | None) -> Config:
    update: dict[str, Any] = {"threads": threads} if threads else {}
    if weights is not None:
        update["weights"] = weights.absolute()
    return config.model_copy(update=update)


def check_every(every: float | None) -> None:
    if every is not None and not 0 < every < float("inf"):
        raise ConfigError(f"--every must be a positive number of metres, not {every}")


def each(values: list[Value] | None, count: int, option: str) -> list[Value] | list[None]:
    """Return one value for each of ``count`` sequences, from none, one, or as many.

    Raises
    ------
    ConfigError
        If the number differs.
    """
    if not values:
        return [None] * count
    if len(values) not in (1, count):
        raise ConfigError(f"{option} is given {len(values)} times for {count} sequences")
    return values if len(values) == count else values * count
