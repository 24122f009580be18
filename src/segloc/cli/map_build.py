"""``segloc map build``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    Cluster,
    ConfigFile,
    Deskew,
    Epsg,
    Every,
    Level,
    MapOut,
    Method,
    Odometry,
    Origin,
    PosesOfEach,
    SelectOfEach,
    Threads,
    Topic,
    Weights,
    Workers,
    check_every,
    each,
    load_config,
    parsed_georeference,
)

if TYPE_CHECKING:
    from ..config import Config
    from ..datasets import Sequence
    from ..map.georeference import Georeference


def _mapped_so(config: Config, *, compact: bool, level: bool) -> Config:
    """Return the configuration with the options of the map."""
    mapping = config.mapping.smallest() if compact else config.mapping
    mapping = mapping.model_copy(update={"level": level or mapping.level})
    return config.model_copy(update={"mapping": mapping})


def build(
    sequences: Annotated[
        list[Path],
        typer.Argument(metavar="SEQUENCE", help="Recordings whose poses share a frame."),
    ],
    out: MapOut,
    method: Method = None,
    poses: PosesOfEach = None,
    select: SelectOfEach = None,
    every: Every = None,
    topic: Topic = None,
    deskew: Deskew = True,
    odometry: Odometry = False,
    level: Level = False,
    epsg: Epsg = None,
    origin: Origin = None,
    compact: Annotated[
        bool,
        typer.Option(
            "--compact",
            help="Write the smallest map; docs/reference/formats.md lists what it loses.",
        ),
    ] = False,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
    workers: Workers = 1,
    cluster: Cluster = None,
    unchecked: Annotated[
        bool, typer.Option("--unchecked", help="Build the map even if scans and poses mismatch.")
    ] = False,
) -> None:
    """Build a map from recordings with poses.

    Several are mapped one by one, here or by --workers or on a --cluster, and then merged. Scans
    or poses with problems (see `segloc doctor`) are rejected: they would smear the map.
    """
    from ..system.files import checked_target

    check_every(every)
    checked_target(out)
    where = parsed_georeference(epsg, origin)
    settings = load_config(config, method, threads, weights)
    settings = _mapped_so(settings, compact=compact, level=level)
    _check_level(sequences, settings, where is not None)
    if cluster is not None:
        sequences = [path.absolute() for path in sequences]
    count = len(sequences)
    named = zip(
        sequences, each(poses, count, "--poses"), each(select, count, "--select"), strict=True
    )
    recordings = [_opened(*row, topic, deskew, odometry, settings) for row in named]
    if not unchecked:
        _check_fit(recordings, sequences, settings)
    _build(recordings, settings, out, every, workers, cluster, where)


def _build(
    recordings: list[Sequence],
    settings: Config,
    out: Path,
    every: float | None,
    workers: int,
    cluster: str | None,
    where: Georeference | None,
) -> None:
    from ..map.build import build_merged_map
    from ..map.georeference import KEY
    from ..system.processes import executing
    from .console import note, progress
    from .map_info import show
    from .results import writing

    with progress("Building the map") as update, executing(workers, cluster) as executor:
        several = executor is not None or len(recordings) > 1
        prior_map = build_merged_map(
            recordings,
            settings,
            update if several else None,
            every_m=every,
            views=None if several else update,
            executor=executor,
            folder=out.absolute().parent,
        )
    if where is not None:
        prior_map.metadata[KEY] = where.to_text()
    with writing(out):
        prior_map.save(out)
    show(prior_map, str(out))
    if (frame := prior_map.metadata.get("frame")) and not settings.mapping.level:
        note(
            f"the map's frame is {frame}, so levelled single scans fit it badly; --level builds a "
            "level map"
        )


def _check_fit(recordings: list[Sequence], paths: list[Path], settings: Config) -> None:
    from .recording import check_fit

    for recording, path in zip(recordings, paths, strict=True):
        check_fit(recording, path, settings.local_cloud)


def _opened(
    path: Path,
    poses: Path | None,
    select: str | None,
    topic: str | None,
    deskew: bool,
    odometry: bool,
    settings: Config,
) -> Sequence:
    """Open a recording with poses."""
    from ..errors import DatasetError
    from ..io.clouds import is_cloud
    from .recording import open_recording

    if path.is_file() and is_cloud(path):
        raise DatasetError(
            f"{path}: a point cloud, not a recording with poses: use `segloc map from-cloud`"
        )
    mount = settings.local_cloud.mount
    recording = open_recording(
        path, poses, select, topic=topic, deskew=deskew, odometry=odometry, mount=mount
    )
    if recording.poses is None:
        raise DatasetError(
            f"{path}: a map needs a pose for every scan: pass --poses FILE, or use --odometry"
        )
    return recording


def _check_level(sequences: list[Path], settings: Config, georeferenced: bool) -> None:
    from ..errors import ConfigError

    if settings.mapping.level and len(sequences) > 1:
        raise ConfigError("--level applies to one recording; several must share a level frame")
    if settings.mapping.level and georeferenced:
        raise ConfigError("--level changes the frame, so --epsg does not apply: omit one")
