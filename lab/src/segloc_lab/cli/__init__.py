"""Verbs that ``segloc-lab`` adds to the command line (entry point ``segloc.commands``)."""

from __future__ import annotations

import typer

from segloc.tools.cli.verbs import HELP_NAMES

from . import bench, evaluate, simulate, train


def register(app: typer.Typer) -> None:
    """Add ``evaluate``, ``simulate``, ``train`` and ``bench``."""
    evaluate.register()
    app.add_typer(evaluate.app, name="evaluate", context_settings=HELP_NAMES)
    app.command("simulate")(simulate.simulate)
    app.add_typer(train.train, name="train", context_settings=HELP_NAMES)
    app.command("bench")(bench.bench)
