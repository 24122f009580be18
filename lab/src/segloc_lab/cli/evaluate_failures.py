"""``segloc evaluate failures``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from segloc.tools.cli.options import (
    ConfigFile,
    Every,
    Poses,
    Recording,
    Select,
    Threads,
    Weights,
    check_every,
    open_localizer,
)

if TYPE_CHECKING:
    from ..evaluation.failures import Funnel


def failures(
    sequence: Recording,
    prior_map: Annotated[Path, typer.Option("--map", metavar="MAP.segmap", help="The prior map.")],
    truth: Annotated[Path, typer.Option(metavar="FILE", help="True poses in the map's frame.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")],
    poses: Poses = None,
    select: Select = None,
    every: Every = None,
    pictures: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Number of worst cases to draw.")
    ] = 5,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
) -> None:
    """Show at which stage each query within map coverage was lost.

    Writes funnel.json, and pictures of the failures that the map should have prevented.
    """
    import json

    import numpy as np

    from segloc import SegmentMap
    from segloc.system.files import replacing
    from segloc.tools.batch import query_positions
    from segloc.tools.cli.console import busy
    from segloc.tools.cli.recording import open_recording, true_poses
    from segloc.tools.cli.results import check_folder

    from ..evaluation.failures import draw_case, funnel
    from ..evaluation.scenario import QuerySet

    check_every(every)
    check_folder(out)
    prior = SegmentMap.load(prior_map)
    localizer = open_localizer(prior, config, threads, weights)
    recording = open_recording(sequence, poses, select)
    truths = true_poses(recording, sequence, truth, None)
    assert truths is not None  # the option is required
    positions = np.flatnonzero(np.isfinite(truths[:, 0, 0]))
    if every is not None:
        positions = query_positions(truths, every, localizer.config.local_cloud.max_gap_m)
    with busy("Examining lost queries"):
        found = funnel(localizer, QuerySet(recording, positions, truths[positions]))
    show(found)
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / "funnel.json") as file:
        file.write((json.dumps(found.to_json(), indent=2, allow_nan=False) + "\n").encode())
    at = {int(index): position for position, index in enumerate(recording.indices)}
    for case in found.worst(pictures):
        with (
            busy(f"Drawing query {case.index}"),
            replacing(out / f"failure_{case.index:06d}.png") as file,
        ):
            file.write(draw_case(localizer, recording, case, at[case.index]))


def show(found: Funnel) -> None:
    """Print a funnel as a table."""
    from segloc.tools.cli.console import table

    rows = [("queries", str(found.queries)), ("within map coverage", str(len(found.cases)))]
    for stage, count in found.counts().items():
        rows.append((f"  {stage}", str(count)))
    rows += [(f"    {gate}", str(count)) for gate, count in found.details().items()]
    table("Where queries are lost", ("", ""), rows)
