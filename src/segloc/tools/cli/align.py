"""``segloc align``"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...errors import ConfigError, DatasetError, MapMismatch, MissingDependency
from ...system.text import number
from . import options
from .console import note, progress, table

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ...config import Config
    from ...loops import AlignConfig, Alignment, MapAlignment, Reposed
    from ..datasets import Sequence

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
    poses: options.PosesOfEach = None,
    select: options.SelectOfEach = None,
    method: options.Method = None,
    every: Annotated[float, typer.Option(metavar="METRES", help="Distance between submaps.")] = 6.0,
    min_support: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Other loops that must agree with a loop.")
    ] = 2,
    topic: options.Topic = None,
    deskew: options.Deskew = True,
    odometry: options.Odometry = False,
    config: options.ConfigFile = None,
    threads: options.Threads = 0,
    workers: options.Workers = 1,
    cluster: options.Cluster = None,
) -> None:
    """Bring sessions with drifting poses, each in its own frame, into one frame.

    Loops within and across sessions are found without an initial guess. Sessions without loops to
    others stay separate. If the first argument is a map (a .segmap file, or tiles), sessions are
    aligned to it instead, and one that does not meet it is rejected.
    """
    from ...config import validate
    from ...loops import AlignConfig, Reposed, align_sessions
    from ...system.processes import executing
    from ..inspect.alignment import summary
    from .recording import open_recordings
    from .results import check_folder

    def open_sessions(paths: list[Path], chosen: Config) -> list[Sequence]:
        local = chosen.local_cloud
        found = open_recordings(
            paths, poses, select, topic=topic, deskew=deskew, odometry=odometry, local=local
        )
        recordings = list(found)
        _check(paths, recordings)
        return recordings

    check_folder(out)
    settings = validate(AlignConfig, {"every_m": every, "min_support": min_support}, "alignment")
    if _is_map(sequences[0]):
        if workers != 1 or cluster is not None:
            raise ConfigError("--workers and --cluster do not apply to a map: omit them")
        _into_map(sequences, out, open_sessions, settings, (config, method, threads))
        return
    chosen = options.load_config(config, method, threads)
    if cluster is not None:
        sequences = [path.absolute() for path in sequences]
    recordings = open_sessions(sequences, chosen)
    with executing(workers, cluster) as executor:
        shared = out.absolute().parent
        alignment = align_sessions(
            recordings, chosen, settings, progress, executor=executor, folder=shared
        )
        aligned = [Reposed(r, T) for r, T in zip(recordings, alignment.poses, strict=True)]
        facts = summary(alignment)
        write_alignment(out, alignment, settings, facts)
        _write_maps(out, alignment, aligned, chosen, executor)
    _show(alignment, facts, out)


def _is_map(path: Path) -> bool:
    """Return whether an argument is a map: a file, or tiles."""
    from ...tiles.index import INDEX

    return path.suffix == ".segmap" or (path / INDEX).exists()


def _check(paths: list[Path], recordings: list[Sequence]) -> None:
    """Reject sessions without poses, and note different sensors."""
    from ..datasets.signature import sensor_of

    for k, (path, recording) in enumerate(zip(paths, recordings, strict=True)):
        if recording.poses is None:
            raise DatasetError(
                f"{path}: session {k} has no poses: pass --poses FILE, or use --odometry"
            )
    sensors = [sensor_of(recording) for recording in recordings]
    if len(set(sensors) - {""}) > 1:
        listed = ", ".join(f"{k} {sensor or 'none'}" for k, sensor in enumerate(sensors))
        note(f"sessions of different sensors may share few segments: {listed}")


def _into_map(
    paths: list[Path],
    out: Path,
    open_sessions: Callable[[list[Path], Config], list[Sequence]],
    settings: AlignConfig,
    chosen: tuple[Path | None, str | None, int],
) -> None:
    """Align sessions to the frame of the first path, a map."""
    from ...loops import align_to_map
    from ...tiles import open_map
    from ..inspect.alignment import summary_to_map

    config, method, threads = chosen
    where, sequences = str(paths[0]), paths[1:]
    if not sequences:
        raise ConfigError(f"{where} is a map: pass the sessions to align after it")
    prior_map = open_map(where)
    described = options.description_of(prior_map)
    if method not in (None, described.descriptor):
        raise MapMismatch(f"{where} has descriptor {described.descriptor!r}, not {method!r}")
    configured = options.map_settings(described, config, threads)
    recordings = open_sessions(sequences, configured)
    alignment = align_to_map(prior_map, recordings, configured, settings, progress)
    facts = summary_to_map(alignment)
    _write_poses(out, alignment, settings, facts)
    for name, line in map_rows(facts):
        print(f"{name}: {line}")
    print(f"{out}: session_0.tum ..., poses in the frame of {paths[0].name}; alignment.json")


def map_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Describe how well each session is connected to the map, by ``summary_to_map``."""
    return [
        (
            each["name"],
            f"{each['anchors_accepted']} of {each['submaps']} submaps agree "
            f"({each['anchors_rejected']} rejected), residual "
            f"{each['residual_after']['median_m']:.2f} m (median); at "
            f"most {each['unanchored_m']:.0f} m from one of them",
        )
        for each in facts["sessions"]
    ]


def _write_poses(
    out: Path,
    alignment: Alignment | MapAlignment,
    settings: AlignConfig,
    facts: dict[str, Any],
) -> None:
    """Write the poses of all sessions, and ``alignment.json``."""
    from ...system.files import write_text
    from ..io import Trajectory, write_tum

    out.mkdir(parents=True, exist_ok=True)
    for name, tracks in (("session", alignment.poses), ("odometry", alignment.odometry)):
        for k, (indices, poses) in enumerate(zip(alignment.indices, tracks, strict=True)):
            write_tum(out / f"{name}_{k}.tum", Trajectory(indices.astype(float), poses))
    _remove_earlier(out, facts)
    facts = {**facts, "odometry": settings.model_dump(include=_NOISE)}
    write_text(out / "alignment.json", json.dumps(facts, indent=2) + "\n")


def _remove_earlier(out: Path, facts: dict[str, Any]) -> None:
    """Remove files of sessions and components that an earlier run there had beyond these."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        earlier = json.loads((out / "alignment.json").read_text("utf-8"))
        for k in range(len(facts["sessions"]), len(earlier["sessions"])):
            for name in ("session", "odometry"):
                (out / f"{name}_{k}.tum").unlink(missing_ok=True)
        for c in range(len(facts["components"]), len(earlier["components"])):
            (out / _map_name(c)).unlink(missing_ok=True)


def write_alignment(
    out: Path, alignment: Alignment, settings: AlignConfig, facts: dict[str, Any]
) -> None:
    """Write poses, loops and a picture of an alignment into a folder."""
    from ...system.files import write_bytes, write_text
    from ..inspect.alignment import loops_csv, loops_jsonl, picture

    _write_poses(out, alignment, settings, facts)
    write_text(out / "loops.csv", loops_csv(alignment))
    write_text(out / "loops.jsonl", loops_jsonl(alignment))
    try:
        write_bytes(out / "before_after.png", picture(alignment))
    except MissingDependency as error:
        note(f"before_after.png not written: {error}")


def _map_name(component: int) -> str:
    """Return the file of a component's map; the largest one has no number."""
    return f"site_{component}.segmap" if component else "site.segmap"


def _write_maps(
    out: Path,
    alignment: Alignment,
    aligned: list[Reposed],
    config: Config,
    executor: Executor | None,
) -> None:
    from ...map.build import build_merged_map
    from .results import writing

    for c, members in enumerate(alignment.components):
        sessions, folder = [aligned[k] for k in members], out.absolute()
        with progress("Building the map") as update:
            prior_map = build_merged_map(sessions, config, update, executor=executor, folder=folder)
        with writing(out / _map_name(c)):
            prior_map.save(out / _map_name(c))


def _show(alignment: Alignment, facts: dict[str, Any], out: Path) -> None:
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
        note(f"session {names} has no loops to the others: see {_map_name(c)}")
