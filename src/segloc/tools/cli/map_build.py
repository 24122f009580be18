"""``segloc map build``"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...errors import ConfigError, DatasetError
from . import options
from .console import note, progress
from .shift import align_command

if TYPE_CHECKING:
    from ...config import Config
    from ...map.georeference import Georeference
    from ..datasets import Sequence


def build(
    sequences: Annotated[
        list[Path],
        typer.Argument(metavar="SEQUENCE", help="Recordings whose poses share a frame."),
    ],
    out: options.MapOut,
    method: options.Method = None,
    poses: options.PosesOfEach = None,
    select: options.SelectOfEach = None,
    every: options.Every = None,
    topic: options.Topic = None,
    deskew: options.Deskew = True,
    odometry: options.Odometry = False,
    level: options.Level = False,
    epsg: options.Epsg = None,
    origin: options.Origin = None,
    compact: Annotated[
        bool,
        typer.Option(
            "--compact",
            help="Write the smallest map; docs/reference/formats.md lists what it loses.",
        ),
    ] = False,
    config: options.ConfigFile = None,
    weights: options.Weights = None,
    threads: options.Threads = 0,
    workers: options.Workers = 1,
    cluster: options.Cluster = None,
    unchecked: options.Unchecked = False,
) -> None:
    """Build a map from recordings with poses.

    Several are mapped one by one, here or by --workers or on a --cluster, and then merged. Scans
    or poses with problems (see `segloc doctor`) are rejected: they would smear the map. So are
    recordings 0.5 m or 1 degree off each other.
    """
    from ...system.files import checked_target
    from .recording import check_fit, check_passes, open_recordings

    options.check_every(every)
    checked_target(out, ".segmap")
    where = options.parsed_georeference(epsg, origin)
    settings = options.load_config(config, method, threads, weights)
    if compact:
        settings = settings.model_copy(update={"mapping": settings.mapping.smallest()})
    settings = options.with_level(settings, level, where)
    if settings.mapping.level and len(sequences) > 1:
        raise ConfigError("--level applies to one recording; several must share a level frame")
    if cluster is not None:
        sequences = [path.absolute() for path in sequences]
    local = settings.local_cloud
    recordings = _with_poses(
        sequences,
        open_recordings(
            sequences, poses, select, topic=topic, deskew=deskew, odometry=odometry, local=local
        ),
    )
    if not unchecked:
        for recording, path in zip(recordings, sequences, strict=True):
            check_fit(recording, path, settings.local_cloud)
        check_passes(
            recordings, settings.local_cloud, align_command(sequences, poses, select, topic)
        )
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
    from ...map.build import build_merged_map
    from ...system.processes import executing
    from .map_info import save_and_show

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
    save_and_show(prior_map, out, where)
    if (frame := prior_map.metadata.get("frame")) and not settings.mapping.level:
        note(
            f"the map's frame is {frame}, so levelled single scans fit it badly; --level builds a "
            "level map"
        )


def _with_poses(paths: list[Path], recordings: Iterator[Sequence]) -> list[Sequence]:
    """Return recordings that can be mapped: scans with poses."""
    from ...system.files import is_cloud

    posed = []
    for path in paths:
        if path.is_file() and is_cloud(path):
            raise DatasetError(
                f"{path}: a point cloud, not a recording with poses: use `segloc map from-cloud`"
            )
        posed.append(next(recordings))
        if posed[-1].poses is None:
            raise DatasetError(
                f"{path}: a map needs a pose for every scan: pass --poses FILE, or use --odometry"
            )
    return posed
