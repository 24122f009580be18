"""``segloc align``"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    Cluster,
    ConfigFile,
    Deskew,
    Method,
    Odometry,
    PosesOfEach,
    SelectOfEach,
    Threads,
    Topic,
    Workers,
    load_config,
)

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..config import Config
    from ..loops import AlignConfig, Alignment, Reposed
    from ..types import Recording

_NOISE = {"odometry_m", "odometry_deg", "odometry_scale"}
"""What odometry was taken to err."""


def align(
    sequences: Annotated[
        list[Path], typer.Argument(metavar="SEQUENCE", help="Sessions: recordings of one place.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="The folder to write to.")],
    poses: PosesOfEach = None,
    select: SelectOfEach = None,
    method: Method = None,
    every: Annotated[float, typer.Option(metavar="METRES", help="Travel between submaps.")] = 6.0,
    min_support: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Other loops that must agree with a loop.")
    ] = 2,
    topic: Topic = None,
    deskew: Deskew = True,
    odometry: Odometry = False,
    config: ConfigFile = None,
    threads: Threads = 0,
    workers: Workers = 1,
    cluster: Cluster = None,
) -> None:
    """Bring sessions with drifting poses, each in its own frame, into one frame.

    Loops within and across sessions are found without an initial guess. Sessions that nothing
    connects stay apart.
    """
    from ..config import validated
    from ..loops import AlignConfig, Reposed, align_sessions
    from ..system.processes import executing
    from .console import progress
    from .options import each
    from .recording import open_recording
    from .results import check_folder

    check_folder(out)
    settings = validated(AlignConfig, {"every_m": every, "min_support": min_support}, "alignment")
    chosen = load_config(config, method, threads)
    if cluster is not None:
        sequences = [path.absolute() for path in sequences]
    count = len(sequences)
    mount = chosen.local_cloud.mount
    recordings = [
        open_recording(
            path, file, scans, topic=topic, deskew=deskew, odometry=odometry, mount=mount
        )
        for path, file, scans in zip(
            sequences, each(poses, count, "--poses"), each(select, count, "--select"), strict=True
        )
    ]
    _check(sequences, recordings)
    with executing(workers, cluster) as executor:
        shared = out.absolute().parent
        alignment = align_sessions(
            recordings, chosen, settings, progress, executor=executor, folder=shared
        )
        aligned = [Reposed(r, T) for r, T in zip(recordings, alignment.poses, strict=True)]
        _write(out, alignment, settings)
        _write_maps(out, alignment, aligned, chosen, executor)
    _show(alignment, out)


def _check(paths: list[Path], recordings: Sequence[Recording]) -> None:
    """Refuse sessions without poses before the work, and say where sensors differ."""
    from ..datasets.signature import sensor_of
    from ..errors import DatasetError
    from .console import note

    for k, (path, recording) in enumerate(zip(paths, recordings, strict=True)):
        if recording.poses is None:
            raise DatasetError(
                f"{path}: session {k} has no poses: name a file by --poses, or use --odometry"
            )
    sensors = [sensor_of(recording) for recording in recordings]
    if len(set(sensors) - {""}) > 1:
        listed = ", ".join(f"{k} {sensor or 'nothing'}" for k, sensor in enumerate(sensors))
        note(f"sessions are of different sensors and may share few segments: {listed}")


def _write(out: Path, alignment: Alignment, settings: AlignConfig) -> None:
    from ..errors import MissingDependency
    from ..io import Trajectory, write_tum
    from ..loops.summary import loops_csv, loops_jsonl, picture, summary
    from ..system.files import replacing, write_text
    from .console import note

    out.mkdir(parents=True, exist_ok=True)
    for name, tracks in (("session", alignment.poses), ("odometry", alignment.odometry)):
        for k, (indices, poses) in enumerate(zip(alignment.indices, tracks, strict=True)):
            write_tum(out / f"{name}_{k}.tum", Trajectory(indices.astype(float), poses))
    write_text(out / "loops.csv", loops_csv(alignment))
    write_text(out / "loops.jsonl", loops_jsonl(alignment))
    facts = {**summary(alignment), "odometry": settings.model_dump(include=_NOISE)}
    write_text(out / "alignment.json", json.dumps(facts, indent=2) + "\n")
    try:
        image = picture(alignment)
    except MissingDependency as error:
        note(f"no before_after.png: {error}")
        return
    with replacing(out / "before_after.png") as stream:
        stream.write(image)


def _suffix(component: int) -> str:
    """The largest component is the prior_map; the others are numbered."""
    return f"_{component}" if component else ""


def _write_maps(
    out: Path,
    alignment: Alignment,
    aligned: list[Reposed],
    config: Config,
    executor: Executor | None,
) -> None:
    from ..map.build import build_merged_map
    from .console import progress
    from .results import writing

    for c, members in enumerate(alignment.components):
        with progress("Building the map") as update:
            prior_map = build_merged_map(
                [aligned[k] for k in members],
                config,
                update,
                executor=executor,
                folder=out.absolute(),
            )
        with writing(out / f"site{_suffix(c)}.segmap"):
            prior_map.save(out / f"site{_suffix(c)}.segmap")


def _show(alignment: Alignment, out: Path) -> None:
    from ..loops.summary import summary
    from .console import note, number, table

    facts = summary(alignment)
    loops, before, after = facts["loops"], facts["residual_before"], facts["residual_after"]
    rows = [
        ("sessions", str(len(alignment.names))),
        ("loops accepted", str(loops["accepted"])),
        ("  across sessions", str(loops["accepted_across_sessions"])),
        ("loops rejected", str(loops["rejected"])),
        ("residual before, median", number(before["median_m"], "m")),
        ("residual after, median", number(after["median_m"], "m")),
    ]
    table(str(out), ("", ""), rows)
    for c, members in enumerate(alignment.components[1:], start=1):
        names = ", ".join(f"{k} ({alignment.names[k]})" for k in members)
        note(f"nothing connects session {names} to the others: see prior_map{_suffix(c)}.segmap")
