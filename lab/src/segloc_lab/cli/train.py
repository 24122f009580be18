"""``segloc train``: make datasets, train networks, and score them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from segloc.errors import ConfigError, DatasetError
from segloc.tools.cli.console import say
from segloc.tools.cli.options import (
    Cluster,
    ConfigFile,
    Method,
    PosesOfEach,
    SelectOfEach,
    Topic,
    each,
    load_config,
)
from segloc.tools.cli.verbs import group

if TYPE_CHECKING:
    from ..training.labels import LabelCounts


Out = Annotated[Path, typer.Option("--out", metavar="DATASET", help="Folder of the dataset.")]
Lengths = Annotated[
    list[float] | None,
    typer.Option(
        "--length",
        metavar="METRES",
        help="Length of a local cloud along the trajectory; 0: single scans.",
        show_default="40, 16 and 0",
    ),
]

Seed = Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Random seed.")]
Threads = Annotated[int, typer.Option(min=1, metavar="COUNT", help="Threads of the engine.")]
Thin = Annotated[
    int, typer.Option(min=1, metavar="COUNT", help="Keep every COUNT-th simulated firing.")
]
Workers = Annotated[
    int,
    typer.Option(
        min=1, metavar="COUNT", help="Processes; with recordings more than one needs --no-register."
    ),
]

Sequences = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="SEQUENCE",
        help="Recordings of one place, one per session.",
        show_default="none: --simulate",
    ),
]

Simulate = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE:N,...",
        help="Simulate worlds instead of reading recordings.",
        show_default="none",
    ),
]

Sensors = Annotated[
    str | None,
    typer.Option(
        metavar="NAME,...", help="Simulated sensors to choose from.", show_default="common ones"
    ),
]


def extract(
    out: Out,
    sequences: Sequences = None,
    poses: PosesOfEach = None,
    select: SelectOfEach = None,
    topic: Topic = None,
    place: Annotated[str, typer.Option(metavar="NAME", help="Name of the place.")] = "place",
    sensor: Annotated[str, typer.Option(metavar="NAME", help="Sensor name.")] = "unknown",
    register: Annotated[bool, typer.Option(help="Align each session with those before it.")] = True,
    simulate: Simulate = None,
    sensors: Sensors = None,
    thin: Thin = 1,
    drive: Annotated[
        float, typer.Option(metavar="METRES", help="Length of a simulated drive.")
    ] = 500.0,
    length: Lengths = None,
    every: Annotated[
        float, typer.Option(metavar="METRES", help="Distance between local clouds.")
    ] = 10.0,
    centroids_only: Annotated[
        bool, typer.Option(help="Label by centroids alone, as the paper does.")
    ] = False,
    seed: Seed = 0,
    workers: Workers = 2,
    cluster: Cluster = None,
    config: ConfigFile = None,
) -> None:
    """Cut recordings or simulated worlds into labelled segments.

    The sequences of one call are sessions of one place and share a frame. Repeated calls append; an
    interrupted run resumes.
    """
    from segloc.config import validate
    from segloc.system.processes import executing
    from segloc.tools.cli.console import note
    from segloc.tools.cli.recording import open_recording

    from ..training.collect import Posed, collect_recordings, collect_worlds, draw_worlds
    from ..training.extract import ExtractConfig
    from ..training.shards import Session, finish

    if bool(sequences) == (simulate is not None):
        raise ConfigError("pass recordings, or worlds to --simulate, and not both")
    lengths = tuple(length) if length else ExtractConfig().lengths_m
    rule = {"rule": "centroids" if centroids_only else "extents"}
    chosen = load_config(config, None, 1)
    values = {
        "lengths_m": lengths,
        "every_m": every,
        "seed": seed,
        "label": rule,
        "local_cloud": chosen.local_cloud,
    }
    settings = validate(ExtractConfig, values, "extraction")
    if simulate is not None:
        names = tuple(sensors.split(",")) if sensors else ()
        worlds = draw_worlds(simulate, seed, length_m=drive, sensors=names, thin=thin)
        with executing(1, cluster) as executor:
            done = collect_worlds(
                out.absolute(),
                worlds,
                settings,
                chosen.segmentation,
                workers=workers,
                progress=say,
                executor=executor,
            )
    else:
        if "--" in place or "/" in place or not place:
            raise ConfigError(f"{place!r} is not a valid name of a place")
        count = len(sequences or [])
        given = (
            sequences or [],
            each(poses or [], count, "--poses"),
            each(select or [], count, "--select"),
        )
        items = [
            Posed(
                Session(place, f"{k:02d}-{path.resolve().name}", sensor),
                open_recording(path, of_path, scans, topic=topic, local=chosen.local_cloud),
            )
            for k, (path, of_path, scans) in enumerate(zip(*given, strict=True))
        ]
        alone = register or count == 1  # each is aligned with those before it
        with executing(1 if alone else workers, cluster) as executor:
            done = collect_recordings(
                out.absolute(),
                items,
                settings,
                chosen.segmentation,
                register=register,
                progress=say,
                executor=executor,
            )
    if not done:
        note("nothing extracted")
        return
    _show(finish(out, done, settings.label), str(out))


def _show(counts: LabelCounts, title: str) -> None:
    from segloc.system.text import number
    from segloc.tools.cli.console import table

    rows = [
        ("segments", f"{counts.segments:,}"),
        ("objects", f"{counts.objects:,}"),
        ("objects with several views", f"{counts.seen_again:,}"),
        ("views per such object", number(counts.views)),
        ("matching pairs", f"{counts.matching:,}"),
        ("matching pairs across sessions", f"{counts.matching_across:,}"),
        ("different pairs", f"{counts.different:,}"),
    ]
    if counts.agreeing == counts.agreeing:
        rows.append(("across sessions, truly one object", f"{100 * counts.agreeing:.1f} %"))
    table(title, ("", ""), rows)


def pairs(
    sequences: Annotated[
        list[Path], typer.Argument(metavar="SEQUENCE", help="Sessions in the order of `align`.")
    ],
    aligned: Annotated[Path, typer.Option(metavar="DIR", help="Output folder of `align`.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Output folder of the dataset.")],
    select: SelectOfEach = None,
    method: Method = None,
    topic: Topic = None,
    config: ConfigFile = None,
) -> None:
    """Cut aligned sessions into labelled segments for training, and list pairs of them.

    Writes a dataset and DIR/pairs.csv: matching and different segments with their distances.
    """
    from segloc.tools.cli.recording import open_recording
    from segloc.tools.cli.results import check_folder

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
        write_dataset(out, members, f"site_{component}", chosen, progress=say)
    count = write_pairs(out / "pairs.csv", out, chosen.seed)
    print(f"{out}: a dataset for `segloc train`, and pairs.csv with {count} matching pairs")


def _sessions(aligned: Path, count: int) -> list[dict[str, Any]]:
    """Return the sessions listed by ``align``."""
    path = aligned / "alignment.json"
    try:
        sessions: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["sessions"]
    except (OSError, ValueError, KeyError) as error:
        raise DatasetError(f"{path}: not written by `segloc align` ({error})") from error
    if len(sessions) != count:
        raise DatasetError(f"{path}: lists {len(sessions)} sessions, but {count} are given")
    return sessions


Commit = Annotated[
    str | None,
    typer.Option(
        metavar="HASH",
        help="Commit of the training sources; stored in the file.",
        show_default="none",
    ),
]
Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of `train extract`.")]
train = group("Make datasets, train descriptors, score them.")


train.command("extract")(extract)
train.command("pairs")(pairs)


@train.command("score")
def score(
    weights: Annotated[
        str, typer.Argument(metavar="WEIGHTS", help="A weights file, or the name of a descriptor.")
    ],
    dataset: Dataset,
    distractors: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DATASET",
            help="Datasets of other worlds that enlarge the pool.",
            show_default="none",
        ),
    ] = None,
    pool: Annotated[
        list[int] | None,
        typer.Option(min=1, metavar="COUNT", help="Segments in the pool.", show_default="all"),
    ] = None,
    threads: Threads = 1,
    seed: Seed = 0,
) -> None:
    """Score a descriptor: ROC area, and recall of segments across sessions."""
    from segloc.tools.cli.console import busy, note, table

    from ..training.metrics import KS, load_descriptor, score_descriptor
    from ..training.shards import load_dataset

    descriptor = load_descriptor(weights, threads)
    with busy("Scoring"):
        report = score_descriptor(
            descriptor,
            load_dataset(dataset),
            [load_dataset(path) for path in distractors or []],
            pools=pool or [],
            seed=seed,
            threads=threads,
        )
    if not report.queries:
        note(f"{dataset}: no recall, which needs objects in two sessions")
    rows = [
        (f"{size:,}", *(f"{recall:.4f}" if report.queries else "-" for recall in found))
        for size, found in report.recalls
    ]
    title = f"{weights} on {dataset}: {report.queries:,} queries, AUC {report.auc}"
    table(title, ("pool", *(f"recall@{k}" for k in KS)), rows)


@train.command("forest")
def forest(
    method: Annotated[
        str, typer.Argument(metavar="METHOD", help="Method whose candidates it prunes.")
    ],
    dataset: Dataset,
    out: Annotated[Path, typer.Option(metavar="FOREST.safetensors", help="Output file.")],
    threads: Threads = 1,
    seed: Seed = 0,
    licence: Annotated[
        str, typer.Option(metavar="NAME", help="Licence of the forest; stored in the file.")
    ] = "MIT",
    commit: Commit = None,
) -> None:
    """Train a random forest that prunes matches (SegMatch, NSM)."""
    from segloc.system.files import checked_target

    from ..training.grow_forest import ForestConfig, train_forest
    from ..training.shards import load_dataset

    checked_target(out)
    card = _card(dataset, licence, commit)
    config = ForestConfig(seed=seed, threads=threads)
    found = train_forest(load_dataset(dataset), out, method, config, card, say)
    typer.echo(
        f"{out}: auc {found.auc:.4f}; kept {found.right_kept:.4f} of the correct and "
        f"{found.wrong_kept:.4f} of the wrong candidates"
    )


def _card(dataset: Path, licence: str, commit: str | None) -> dict[str, Any]:
    command = " ".join(["segloc", *sys.argv[1:]])
    card = {"data": dataset.name, "command": command, "licence": licence}
    return card if commit is None else {**card, "commit": commit}


_EXPLAINED = {
    "dsm": "Train DSM: 16 numbers, an X-conv network over 160 to 4 points.",
    "esm": "Train ESM: 16 numbers, DSM's predecessor with more points.",
    "segmap": "Train SegMap: 64 numbers, a network over a voxel grid.",
    "profile": "Train profile, segloc's own: 32 numbers, metric shape profiles.",
}


def _add(network: str, help_text: str) -> None:
    def command(
        dataset: Dataset,
        out: Annotated[Path, typer.Option(metavar="WEIGHTS.safetensors", help="Output file.")],
        config: Annotated[
            Path | None,
            typer.Option(
                metavar="FILE",
                help="YAML of a TrainConfig; options override it.",
                show_default="none",
            ),
        ] = None,
        steps: Annotated[
            int | None,
            typer.Option(min=1, metavar="COUNT", help="Training steps.", show_default="3000"),
        ] = None,
        minutes: Annotated[
            float | None,
            typer.Option(metavar="MINUTES", help="Stop after this time.", show_default="never"),
        ] = None,
        threads: Annotated[
            int | None,
            typer.Option(min=1, metavar="COUNT", help="PyTorch threads.", show_default="1"),
        ] = None,
        device: Annotated[
            str | None, typer.Option(metavar="NAME", help="cpu or cuda.", show_default="cpu")
        ] = None,
        loss: Annotated[
            str | None,
            typer.Option(
                metavar="NAME",
                help="info_nce, triplet, esm or multi_similarity.",
                show_default="info_nce",
            ),
        ] = None,
        seed: Annotated[
            int | None, typer.Option(min=0, metavar="NUMBER", help="Random seed.", show_default="0")
        ] = None,
        licence: Annotated[
            str, typer.Option(metavar="NAME", help="Licence of the weights; stored in the file.")
        ] = "MIT",
        commit: Commit = None,
    ) -> None:
        given = {
            "network": network,
            "steps": steps,
            "max_minutes": minutes,
            "threads": threads,
            "device": device,
            "loss": loss,
            "seed": seed,
        }
        chosen = {k: v for k, v in given.items() if v is not None}
        _train(_card(dataset, licence, commit), dataset, out, config, chosen)

    command.__doc__ = help_text
    train.command(network)(command)


def _train(
    card: dict[str, Any], dataset: Path, out: Path, config: Path | None, given: dict[str, Any]
) -> None:
    from segloc.system.files import checked_target

    from ..training.config import load_train_config, require_torch
    from ..training.shards import load_dataset

    require_torch()
    from ..training.train import train as run

    settings = load_train_config(config, given)
    checked_target(out)
    scores = run(load_dataset(dataset), out, settings, card, say)
    typer.echo(f"{out}: {scores}")


for _name, _text in _EXPLAINED.items():
    _add(_name, _text)
