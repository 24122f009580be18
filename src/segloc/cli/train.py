"""``segloc train``: datasets, networks, and how good they are."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import ConfigFile

if TYPE_CHECKING:
    from ..training.extract import ExtractConfig
    from ..training.labels import LabelCounts
    from ..training.shards import Session
    from ..training.worlds import WorldSpec

Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="What `train extract` wrote.")]
Out = Annotated[Path, typer.Option("--out", metavar="DATASET", help="The folder to write to.")]
Lengths = Annotated[
    list[float] | None,
    typer.Option("--length", metavar="METRES", help="Way a local cloud spans; 0: single scans."),
]

train = typer.Typer(
    help="Make datasets, train descriptors, score them.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@train.command("extract")
def extract(
    out: Out,
    sequences: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SEQUENCE]...", help="Recordings of one place, one a session."),
    ] = None,
    poses: Annotated[
        list[Path] | None, typer.Option(help="TUM or KITTI: one for all, or one a sequence.")
    ] = None,
    select: Annotated[
        list[str] | None,
        typer.Option(metavar="A:B[,C:D]", help="Only these scans: one for all, or one a sequence."),
    ] = None,
    place: Annotated[str, typer.Option(help="A name for the place.")] = "place",
    sensor: Annotated[str, typer.Option(help="A name for the sensor.")] = "unknown",
    register: Annotated[bool, typer.Option(help="Align each session with those before it.")] = True,
    simulate: Annotated[
        str | None, typer.Option(metavar="SCENE:N,...", help="Draw worlds instead of recordings.")
    ] = None,
    sensors: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Simulated sensors to choose from.")
    ] = None,
    thin: Annotated[int, typer.Option(min=1, help="Simulate every so many firings only.")] = 1,
    drive: Annotated[float, typer.Option(help="Metres of a simulated drive.")] = 500.0,
    length: Lengths = None,
    every: Annotated[float, typer.Option(help="Metres between local clouds.")] = 10.0,
    centroids_only: Annotated[
        bool, typer.Option(help="Label by centroids alone, as the paper does.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes that simulate.")] = 2,
    config: ConfigFile = None,
) -> None:
    """Cut recordings or simulated worlds into labelled segments.

    The sequences of one call are sessions of one place and share a frame; calls add up. What is
    finished stays: a call that was cut off goes on when it is given again.
    """
    from ..errors import ConfigError
    from ..training.extract import ExtractConfig
    from ..training.labels import LabelConfig
    from ..training.shards import finish
    from .console import note

    if bool(sequences) == (simulate is not None):
        raise ConfigError("name recordings, or worlds to --simulate, and not both")
    lengths = tuple(length) if length else ExtractConfig().lengths_m
    settings = ExtractConfig(
        lengths_m=lengths,
        every_m=every,
        seed=seed,
        label=LabelConfig(rule="centroids" if centroids_only else "extents"),
    )
    if simulate is not None:
        from ..training.worlds import draw_worlds

        chosen = tuple(sensors.split(",")) if sensors else ()
        done = _simulate(
            out,
            draw_worlds(simulate, seed, length_m=drive, sensors=chosen, thin=thin),
            settings,
            workers,
            config,
        )
    else:
        named = _Recordings(sequences or [], poses or [], select or [], place, sensor)
        done = named.collect(out, settings, register, config)
    if not done:
        note("nothing was extracted")
        return
    _show(finish(out, done, settings.label), str(out))


def _simulate(
    out: Path,
    worlds: list[WorldSpec],
    settings: ExtractConfig,
    workers: int,
    config: Path | None,
) -> list[Session]:
    from ..training.collect import collect_worlds
    from .options import load_config

    segmentation = load_config(config, None, 1).segmentation
    return collect_worlds(out, worlds, settings, segmentation, workers=workers, progress=_say)


class _Recordings:
    """The recordings that a command line names."""

    def __init__(
        self, sequences: list[Path], poses: list[Path], select: list[str], place: str, sensor: str
    ) -> None:
        from ..errors import ConfigError

        if "--" in place or "/" in place or not place:
            raise ConfigError(f"{place!r} cannot be the name of a place")
        count = len(sequences)
        self.rows = list(
            zip(
                sequences,
                _each(poses, count, "--poses"),
                _each(select, count, "--select"),
                strict=True,
            )
        )
        self.place, self.sensor = place, sensor

    def collect(
        self, out: Path, settings: ExtractConfig, register: bool, config: Path | None
    ) -> list[Session]:
        from ..datasets import open_sequence
        from ..training.collect import Posed, collect_recordings
        from ..training.shards import Session
        from .options import load_config

        items = [
            Posed(
                Session(self.place, f"{k:02d}-{path.resolve().name}", self.sensor),
                open_sequence(path, poses, select),
            )
            for k, (path, poses, select) in enumerate(self.rows)
        ]
        segmentation = load_config(config, None, 1).segmentation
        return collect_recordings(
            out, items, settings, segmentation, register=register, progress=_say
        )


def _each(values: list, count: int, option: str) -> list:  # type: ignore[type-arg]
    from ..errors import ConfigError

    if len(values) not in (0, 1, count):
        raise ConfigError(f"{option} is given {len(values)} times for {count} sequences")
    return list(values) if len(values) == count else (values or [None]) * count


def _say(text: str) -> None:
    typer.echo(text, err=True)


def _show(counts: LabelCounts, title: str) -> None:
    from .console import number, table

    rows = [
        ("segments", f"{counts.segments:,}"),
        ("objects", f"{counts.objects:,}"),
        ("objects with several views", f"{counts.seen_again:,}"),
        ("views of each of those", number(counts.views)),
        ("matching pairs", f"{counts.matching:,}"),
        ("matching pairs across sessions", f"{counts.matching_across:,}"),
        ("pairs that differ", f"{counts.different:,}"),
    ]
    if counts.agreeing == counts.agreeing:
        rows.append(("of the pairs across, truly one object", f"{100 * counts.agreeing:.1f} %"))
    table(title, ("", ""), rows)


@train.command("score")
def score(
    weights: Annotated[str, typer.Argument(help="A weights file, or a descriptor's name.")],
    dataset: Dataset,
    distractors: Annotated[
        list[Path] | None, typer.Option(help="Datasets of other worlds that fill the pool.")
    ] = None,
    pool: Annotated[list[int] | None, typer.Option(help="Sizes of the pool.")] = None,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 0,
) -> None:
    """ROC area and recall among the k nearest, of each session against the others."""
    from ..training.scoring import KS, load_descriptor, score_descriptor
    from ..training.shards import load_dataset
    from .console import table

    descriptor = load_descriptor(weights, threads)
    report = score_descriptor(
        descriptor,
        load_dataset(dataset),
        [load_dataset(path) for path in distractors or []],
        pools=pool or [],
        seed=seed,
        threads=threads,
    )
    rows = [(f"{size:,}", *(f"{recall:.4f}" for recall in found)) for size, found in report.recalls]
    title = f"{weights} on {dataset}: {report.queries:,} queries, AUC {report.auc}"
    table(title, ("pool", *(f"recall@{k}" for k in KS)), rows)


@train.command("forest")
def forest(
    method: Annotated[str, typer.Argument(help="The method whose candidates it prunes.")],
    dataset: Dataset,
    out: Annotated[Path, typer.Option(metavar="FOREST.safetensors", help="The result.")],
    threads: Annotated[int, typer.Option(min=1)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    licence: Annotated[str, typer.Option(help="Of the forest; goes into the file.")] = "MIT",
) -> None:
    """A random forest that tells right candidates from wrong ones (SegMatch, NSM)."""
    from ..files import checked_target
    from ..training.forest import ForestConfig, train_forest
    from ..training.shards import load_dataset

    checked_target(out)
    card = _card(dataset, licence)
    config = ForestConfig(seed=seed, threads=threads)
    found = train_forest(load_dataset(dataset), out, method, config, card, _say)
    typer.echo(
        f"{out}: auc {found.auc:.4f}; kept of the right {found.right_kept:.4f}, "
        f"of the wrong {found.wrong_kept:.4f}"
    )


def _card(dataset: Path, licence: str) -> dict[str, Any]:
    command = " ".join(["segloc", *sys.argv[1:]])
    return {"data": dataset.name, "command": command, "licence": licence}


_EXPLAINED = {
    "dsm": "DSM, 16 numbers from 160 down to 4 points.",
    "esm": "ESM, DSM's predecessor with more points.",
    "segmap": "SegMap's network over a grid of voxels, 64 numbers.",
    "profile": "Profile, segloc's own: metric shape profiles, 24 numbers.",
}


def _add(network: str, help_text: str) -> None:
    def command(
        dataset: Dataset,
        out: Annotated[Path, typer.Option(metavar="WEIGHTS.safetensors", help="The result.")],
        config: Annotated[
            Path | None, typer.Option(help="YAML of a TrainConfig; options come on top.")
        ] = None,
        steps: Annotated[int | None, typer.Option(min=1)] = None,
        minutes: Annotated[float | None, typer.Option(help="Stop after so long.")] = None,
        threads: Annotated[int | None, typer.Option(min=1)] = None,
        device: Annotated[str | None, typer.Option(metavar="cpu|cuda")] = None,
        loss: Annotated[str | None, typer.Option(help="Or triplet, esm, multi_similarity.")] = None,
        seed: Annotated[int | None, typer.Option(min=0)] = None,
        licence: Annotated[str, typer.Option(help="Of the weights; goes into the file.")] = "MIT",
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
        _train(dataset, out, config, {k: v for k, v in given.items() if v is not None}, licence)

    command.__doc__ = help_text
    train.command(network)(command)


def _train(
    dataset: Path, out: Path, config: Path | None, given: dict[str, Any], licence: str
) -> None:
    from ..errors import MissingDependency
    from ..files import checked_target

    try:
        import torch
    except ImportError as error:
        raise MissingDependency("torch", "train", "training") from error
    from ..training.options import load_train_config
    from ..training.shards import load_dataset
    from ..training.train import train as run

    settings = load_train_config(config, given)
    checked_target(out)
    data = load_dataset(dataset)
    card = {**_card(dataset, licence), "torch": torch.__version__}
    scores = run(data, out, settings, card, _say)
    typer.echo(f"{out}: auc {scores.auc:.4f}, recall@25 {scores.recall:.4f}")


for _name, _text in _EXPLAINED.items():
    _add(_name, _text)
