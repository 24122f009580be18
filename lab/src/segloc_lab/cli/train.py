"""``segloc train``: datasets, networks, and how good they are."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from segloc.cli.console import say
from segloc.cli.verbs import group

from .train_extract import extract
from .train_pairs import pairs

Commit = Annotated[
    str | None,
    typer.Option(
        metavar="HASH",
        help="Commit of the training sources; stored in the file.",
        show_default="not said",
    ),
]
Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="What `train extract` wrote.")]
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
            help="Datasets of other worlds that fill the pool.",
            show_default="none",
        ),
    ] = None,
    pool: Annotated[
        list[int] | None,
        typer.Option(
            min=1, metavar="COUNT", help="Segments in the pool.", show_default="all there are"
        ),
    ] = None,
    threads: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Threads of the engine.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Random seed.")] = 0,
) -> None:
    """Score a descriptor: ROC area, and recall of each session's segments among the others."""
    from segloc.cli.console import busy, note, table

    from ..training.scoring import KS, load_descriptor, score_descriptor
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
        note(f"{dataset}: no recall: it needs objects of two sessions")
    rows = [
        (f"{size:,}", *(f"{recall:.4f}" if report.queries else "-" for recall in found))
        for size, found in report.recalls
    ]
    title = f"{weights} on {dataset}: {report.queries:,} queries, AUC {report.auc}"
    table(title, ("pool", *(f"recall@{k}" for k in KS)), rows)


@train.command("forest")
def forest(
    method: Annotated[
        str, typer.Argument(metavar="METHOD", help="The method whose candidates it prunes.")
    ],
    dataset: Dataset,
    out: Annotated[Path, typer.Option(metavar="FOREST.safetensors", help="The result.")],
    threads: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Threads of the engine.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Random seed.")] = 0,
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
        f"{out}: auc {found.auc:.4f}; kept of the right {found.right_kept:.4f}, "
        f"of the wrong {found.wrong_kept:.4f}"
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
        out: Annotated[Path, typer.Option(metavar="WEIGHTS.safetensors", help="The result.")],
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
            typer.Option(min=1, metavar="COUNT", help="Threads of PyTorch.", show_default="1"),
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
            int | None,
            typer.Option(min=0, metavar="NUMBER", help="Random seed.", show_default="0"),
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
