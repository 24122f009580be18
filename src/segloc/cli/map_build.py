"""``segloc map build``"""

from __future__ import annotations

from typing import Annotated

import typer

from .options import (
    ConfigFile,
    Every,
    MapOut,
    Poses,
    Recording,
    Select,
    Threads,
    check_every,
    load_config,
)


def build(
    sequence: Recording,
    out: MapOut,
    method: Annotated[
        str | None, typer.Option(metavar="NAME", help="How segments are described.")
    ] = None,
    poses: Poses = None,
    select: Select = None,
    every: Every = None,
    config: ConfigFile = None,
    threads: Threads = 0,
) -> None:
    """Build a map from a recording with poses."""
    from ..datasets import open_sequence
    from ..files import checked_target
    from ..mapping import build_map
    from .console import progress
    from .map_info import show

    check_every(every)
    checked_target(out)
    settings = load_config(config, method, threads)
    recording = open_sequence(sequence, poses, select)
    with progress("Building the map") as update:
        site = build_map(recording, settings, every_m=every, progress=update)
    site.save(out)
    show(site, str(out))
