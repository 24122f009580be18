"""How verbs replace a map: one at a time, so that nothing is lost between reading and writing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Keep other verbs from writing ``out`` meanwhile; who comes second waits, and says so."""
    from ..files import checked_target
    from ..locks import exclusive
    from .console import note

    checked_target(out)
    with exclusive(out, lambda: note(f"{out}: waiting for another process that writes it")):
        yield
