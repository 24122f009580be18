"""``segloc train pairs``"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from segloc.cli.options import ConfigFile, Method, SelectOfEach, Topic, each, load_config
from segloc.errors import DatasetError


def pairs(
    sequences: Annotated[
        list[Path], typer.Argument(metavar="SEQUENCE", help="Sessions in the order of `align`.")
    ],
    aligned: Annotated[Path, typer.Option(metavar="DIR", help="Folder that `align` wrote.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the dataset to write.")],
    select: SelectOfEach = None,
    method: Method = None,
    topic: Topic = None,
    config: ConfigFile = None,
) -> None:
    """Cut aligned sessions into labelled segments to train on, and list pairs of them.

    Writes a dataset and DIR/pairs.csv: matching and different segments with their distances.
    """
    from segloc.cli.console import say
    from segloc.cli.recording import open_recording
    from segloc.cli.results import check_folder

    from ..training.aligned_pairs import write_dataset, write_pairs

    check_folder(out)
    chosen = load_config(config, method, 1)
    sessions = _sessions(aligned, len(sequences))
    recordings = [
        open_recording(path, aligned / session["file"], scans, topic=topic)
        for path, session, scans in zip(
            sequences, sessions, each(select, len(sequences), "--select"), strict=True
        )
    ]
    for component in sorted({session["component"] for session in sessions}):
        members = [
            recording
            for recording, session in zip(recordings, sessions, strict=True)
            if session["component"] == component
        ]
        write_dataset(out, members, f"site_{component}", chosen.segmentation, progress=say)
    count = write_pairs(out / "pairs.csv", out, chosen.seed)
    print(f"{out}: a dataset for `segloc train`, and pairs.csv with {count} matching pairs")


def _sessions(aligned: Path, count: int) -> list[dict[str, Any]]:
    """The sessions that ``align`` listed."""
    path = aligned / "alignment.json"
    try:
        sessions: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["sessions"]
    except (OSError, ValueError, KeyError) as error:
        raise DatasetError(f"{path}: not written by `segloc align` ({error})") from error
    if len(sessions) != count:
        raise DatasetError(f"{path}: {len(sessions)} sessions were aligned, but {count} are given")
    return sessions
