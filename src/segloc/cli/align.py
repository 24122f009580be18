"""``segloc align``"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigError
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
    from ..datasets import Sequence
    from ..loops import AlignConfig, Alignment, MapAlignment, Reposed

_NOISE = {"odometry_m", "odometry_deg", "odometry_scale"}
"""Settings of odometry's errors."""


def align(
    sequences: Annotated[
        list[Path],
        typer.Argument(
            metavar="SEQUENCE",
            help="Sessions of one place; the first may be a map to bring the others into.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")],
    poses: PosesOfEach = None,
    select: SelectOfEach = None,
    method: Method = None,
    every: Annotated[float, typer.Option(metavar="METRES", help="Distance between submaps.")] = 6.0,
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

    Loops within and across sessions are found without an initial guess. Sessions without loops to
    others stay separate. If the first argument is a map (a .segmap file, or tiles), sessions are
    aligned to it instead, and one that does not meet it is rejected.
    """
    from ..config import validated
    from ..loops import AlignConfig, Reposed, align_sessions
    from ..system.processes import executing
    from .console import progress
    from .results import check_folder

    check_folder(out)
    settings = validated(AlignConfig, {"every_m": every, "min_support": min_support}, "alignment")
    read = _Read(poses, select, topic, deskew, odometry)
    if is_map(sequences[0]):
        if workers != 1 or cluster is not None:
            raise ConfigError("--workers and --cluster do not apply to a map: omit them")
        _into_map(sequences, out, read, settings, (config, method, threads))
        return
    chosen = load_config(config, method, threads)
    if cluster is not None:
        sequences = [path.absolute() for path in sequences]
    recordings = read.opened(sequences, chosen)
    with executing(workers, cluster) as executor:
        shared = out.absolute().parent
        alignment = align_sessions(
            recordings, chosen, settings, progress, executor=executor, folder=shared
        )
        aligned = [Reposed(r, T) for r, T in zip(recordings, alignment.poses, strict=True)]
        _write(out, alignment, settings)
        _write_maps(out, alignment, aligned, chosen, executor)
    _show(alignment, out)


@dataclass(frozen=True)
class _Read:
    """Options for reading sessions."""

    poses: list[Path] | None
    select: list[str] | None
    topic: str | None
    deskew: bool
    odometry: bool

    def opened(self, sequences: list[Path], config: Config) -> list[Sequence]:
        """Open the sessions, all with poses."""
        from .options import each
        from .recording import open_recording

        count = len(sequences)
        files = each(self.poses, count, "--poses"), each(self.select, count, "--select")
        recordings = [
            open_recording(
                path,
                file,
                scans,
                topic=self.topic,
                deskew=self.deskew,
                odometry=self.odometry,
                mount=config.local_cloud.mount,
            )
            for path, file, scans in zip(sequences, *files, strict=True)
        ]
        _check(sequences, recordings)
        return recordings


def is_map(path: Path) -> bool:
    """Return whether an argument is a map: a file, or tiles."""
    from ..tiles.index import INDEX

    return path.suffix == ".segmap" or (path / INDEX).exists()


def _into_map(
    paths: list[Path],
    out: Path,
    read: _Read,
    settings: AlignConfig,
    options: tuple[Path | None, str | None, int],
) -> None:
    """Align sessions to the frame of the first path, a map."""
    from ..errors import MapMismatch
    from ..loops import align_to_map
    from ..map.segment_map import SegmentMap
    from ..tiles import TiledMap, holds_tiles
    from .console import progress
    from .options import map_settings

    config, method, threads = options
    where, sequences = str(paths[0]), paths[1:]
    if not sequences:
        raise ConfigError(f"{where} is a map: pass the sessions to align after it")
    prior_map = TiledMap(where) if holds_tiles(where) else SegmentMap.load(where)
    described = prior_map if isinstance(prior_map, SegmentMap) else prior_map.coarse()
    if method not in (None, described.descriptor):
        raise MapMismatch(f"{where} has descriptor {described.descriptor!r}, not {method!r}")
    chosen = map_settings(described, config, threads)
    recordings = read.opened(sequences, chosen)
    alignment = align_to_map(prior_map, recordings, chosen, settings, progress)
    _write_in_map(out, alignment, settings)
    for name, line in map_rows(alignment):
        print(f"{name}: {line}")
    print(f"{out}: session_0.tum ..., poses in the frame of {paths[0].name}; alignment.json")


def map_rows(alignment: MapAlignment) -> list[tuple[str, str]]:
    """Describe how well each session is connected to the map."""
    from ..loops.summary import summary_to_map

    lines = []
    for facts in summary_to_map(alignment)["sessions"]:
        residual = facts["residual_after"]["median_m"]
        lines.append(
            (
                facts["name"],
                f"{facts['anchors_accepted']} of {facts['submaps']} submaps agree "
                f"({facts['anchors_rejected']} rejected), residual {residual:.2f} m (median); at "
                f"most {facts['unanchored_m']:.0f} m from one of them",
            )
        )
    return lines


def _write_in_map(out: Path, alignment: MapAlignment, settings: AlignConfig) -> None:
    from ..loops.summary import summary_to_map
    from ..system.files import write_text

    out.mkdir(parents=True, exist_ok=True)
    _write_tracks(out, alignment)
    facts = {**summary_to_map(alignment), "odometry": settings.model_dump(include=_NOISE)}
    write_text(out / "alignment.json", json.dumps(facts, indent=2) + "\n")


def _write_tracks(out: Path, alignment: Alignment | MapAlignment) -> None:
    from ..io import Trajectory, write_tum

    for name, tracks in (("session", alignment.poses), ("odometry", alignment.odometry)):
        for k, (indices, poses) in enumerate(zip(alignment.indices, tracks, strict=True)):
            write_tum(out / f"{name}_{k}.tum", Trajectory(indices.astype(float), poses))


def _check(paths: list[Path], recordings: list[Sequence]) -> None:
    """Reject sessions without poses, and note different sensors."""
    from ..datasets.signature import sensor_of
    from ..errors import DatasetError
    from .console import note

    for k, (path, recording) in enumerate(zip(paths, recordings, strict=True)):
        if recording.poses is None:
            raise DatasetError(
                f"{path}: session {k} has no poses: pass --poses FILE, or use --odometry"
            )
    sensors = [sensor_of(recording) for recording in recordings]
    if len(set(sensors) - {""}) > 1:
        listed = ", ".join(f"{k} {sensor or 'none'}" for k, sensor in enumerate(sensors))
        note(f"sessions of different sensors may share few segments: {listed}")


def _write(out: Path, alignment: Alignment, settings: AlignConfig) -> None:
    from ..errors import MissingDependency
    from ..loops.summary import loops_csv, loops_jsonl, picture, summary
    from ..system.files import replacing, write_text
    from .console import note

    out.mkdir(parents=True, exist_ok=True)
    _write_tracks(out, alignment)
    write_text(out / "loops.csv", loops_csv(alignment))
    write_text(out / "loops.jsonl", loops_jsonl(alignment))
    facts = {**summary(alignment), "odometry": settings.model_dump(include=_NOISE)}
    write_text(out / "alignment.json", json.dumps(facts, indent=2) + "\n")
    try:
        image = picture(alignment)
    except MissingDependency as error:
        note(f"before_after.png not written: {error}")
        return
    with replacing(out / "before_after.png") as stream:
        stream.write(image)


def _suffix(component: int) -> str:
    """Return "" for the largest component, a number for the others."""
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
        note(f"session {names} has no loops to the others: see site{_suffix(c)}.segmap")
