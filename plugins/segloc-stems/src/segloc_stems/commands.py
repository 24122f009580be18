"""The verbs ``segloc stems map`` and ``segloc stems localize``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from segloc.errors import DatasetError
from segloc.tools.cli import options
from segloc.tools.cli.console import note, progress, table
from segloc.tools.cli.verbs import HELP_NAMES, group

MapFile = Annotated[Path, typer.Option("--map", metavar="MAP.segmap", help="The map of stems.")]
OutFile = Annotated[Path, typer.Option(metavar="MAP.segmap", help="Output file.")]
_MAX_ROWS = 20


def register(app: typer.Typer) -> None:
    """Add the verbs: the entry point of the group ``segloc.commands``."""
    stems = group("Map and localize by stems, poles and columns alone.")
    stems.command("map")(build)
    stems.command("localize")(localize)
    app.add_typer(stems, name="stems", context_settings=HELP_NAMES)


def build(
    sequence: options.Recording,
    out: OutFile,
    poses: options.Poses = None,
    select: options.Select = None,
    topic: options.Topic = None,
) -> None:
    """Map the stems of a recording with poses."""
    from segloc.system.files import checked_target
    from segloc.tools.cli.recording import open_recording

    from . import LandmarkMapper, find_stems

    checked_target(out)
    recording = open_recording(sequence, poses, select, topic=topic)
    if recording.poses is None:
        raise DatasetError(f"{sequence}: a map needs a pose per scan: pass them with --poses")
    mapper = LandmarkMapper()
    with progress("Finding stems") as update:
        for i in range(len(recording)):
            mapper.add(find_stems(recording.scan(i)), recording.poses[i])
            update(i + 1, len(recording))
    site = mapper.map()
    if not len(site):
        raise DatasetError(f"{sequence}: no stems, poles or columns in {len(recording)} scans")
    site.save(out)
    print(f"{out}: {len(site)} stems of {len(recording)} scans")


def localize(
    sequence: options.Recording,
    prior_map: MapFile,
    select: options.Select = None,
    topic: options.Topic = None,
) -> None:
    """Localize each scan of a recording by its stems, without poses."""
    from segloc.tools.batch.report import sentence
    from segloc.tools.cli.recording import open_recording
    from segloc.tools.datasets import NO_POSES

    from . import LandmarkLocalizer, LandmarkMap, find_stems

    localizer = LandmarkLocalizer(LandmarkMap.load(prior_map))
    recording = open_recording(sequence, Path(NO_POSES), select, topic=topic)
    results = []
    with progress("Localizing") as update:
        for i in range(len(recording)):
            results.append(localizer.localize(find_stems(recording.scan(i))))
            update(i + 1, len(recording))
    rows = [(str(k), sentence(each)) for k, each in zip(recording.indices, results, strict=True)]
    table(
        f"{recording.name} in {prior_map.name}", ("query", "answer"), rows[:_MAX_ROWS], texts=(1,)
    )
    if len(rows) > _MAX_ROWS:
        note(f"{len(rows) - _MAX_ROWS} more")
    print(f"localized: {sum(each.localized for each in results)} of {len(results)}")
