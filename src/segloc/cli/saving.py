"""How verbs write: maps one at a time so that nothing is lost, the files of a folder together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Keep other verbs from writing ``out`` meanwhile; who comes second waits, and says so."""
    from ..system.files import checked_target
    from ..system.locks import exclusive
    from .console import note

    checked_target(out)
    with exclusive(out, lambda: note(f"{out}: waiting for another process that writes it")):
        yield


def write_together(out: Path, files: dict[str, bytes]) -> None:
    """Write files of a folder, and of folders in it: all of them, or none."""
    from ..system.files import replacing

    folders = sorted({(out / name).parent for name in files} | {out})
    made = [folder for folder in folders if not folder.exists()]
    for folder in made:
        folder.mkdir(parents=True)
    try:
        with ExitStack() as stack:  # nothing is renamed before everything is written
            for name, data in files.items():
                stack.enter_context(replacing(out / name)).write(data)
    except BaseException:
        for folder in reversed(made):
            with suppress(OSError):
                folder.rmdir()
        raise
