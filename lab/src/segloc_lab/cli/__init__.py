"""What this distribution adds to the command line, by the entry point group ``segloc.commands``."""

from __future__ import annotations

import typer

from . import bench
from . import studies as evaluate


def register(app: typer.Typer) -> None:
    """Add ``segloc bench`` and the paper's studies of ``segloc evaluate``."""
    app.command("bench")(bench.bench)
    evaluate.register(app)
