"""``segloc map build``"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    ConfigFile,
    Deskew,
    Every,
    Level,
    MapOut,
    Method,
    Odometry,
    Poses,
    Recording,
    Select,
    Threads,
    Topic,
    Weights,
    check_every,
    load_config,
)

if TYPE_CHECKING:
    from ..config import Config


def _mapped_so(config: Config, *, compact: bool, level: bool) -> Config:
    """The configuration with what the options say of the map."""
    mapping = config.mapping.smallest() if compact else config.mapping
    mapping = mapping.model_copy(update={"level": level or mapping.level})
    return config.model_copy(update={"mapping": mapping})


def build(
    sequence: Recording,
    out: MapOut,
    method: Method = None,
    poses: Poses = None,
    select: Select = None,
    every: Every = None,
    topic: Topic = None,
    deskew: Deskew = True,
    odometry: Odometry = False,
    level: Level = False,
    compact: Annotated[
        bool,
        typer.Option("--compact", help="As small as it can be; docs/formats.md has its losses."),
    ] = False,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
    unchecked: Annotated[
        bool, typer.Option("--unchecked", help="Build it even where scans and poses do not fit.")
    ] = False,
) -> None:
    """Build a map from a recording with poses.

    What `segloc doctor` finds wrong with its scans or poses is refused: the map would be smeared.
    """
    from ..errors import DatasetError
    from ..files import checked_target
    from ..map.build import build_map
    from .console import note, progress
    from .map_info import show
    from .recording import check_fit, open_recording
    from .saving import writing

    check_every(every)
    checked_target(out)
    settings = load_config(config, method, threads, weights)
    settings = _mapped_so(settings, compact=compact, level=level)
    mount = settings.local_cloud.mount
    recording = open_recording(
        sequence, poses, select, topic=topic, deskew=deskew, odometry=odometry, mount=mount
    )
    if recording.poses is None:
        raise DatasetError(
            f"{sequence}: a map needs a pose for every scan: name a file by --poses, "
            "or use --odometry"
        )
    if not unchecked:
        check_fit(recording, sequence, settings.local_cloud)
    with progress("Building the map") as update:
        prior_map = build_map(recording, settings, every_m=every, progress=update)
    with writing(out):
        prior_map.save(out)
    show(prior_map, str(out))
    if (frame := prior_map.metadata.get("frame")) and not settings.mapping.level:
        note(
            f"the map's frame is {frame}, and scans that are levelled by themselves fit it badly; "
            "--level builds it level"
        )
