"""Says in a folder of what code and weights its results are, for tables that are made later.

python -m segloc_lab.results.stamp out/accumulated-dsm dsm
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from segloc.errors import DatasetError
from segloc.system.files import write_text

from ..script import parser
from .store import Origin

FILE = "produced.json"


def stamp(folder: Path, methods: list[str]) -> None:
    """Write the fingerprints of the code as it is, and of the methods' weights."""
    write_text(folder / FILE, json.dumps(asdict(Origin.now(methods)), indent=1) + "\n")


def stamped(folder: Path) -> Origin:
    """What :func:`stamp` wrote.

    Raises
    ------
    DatasetError
        If nothing says what the folder's results are of.
    """
    path = folder / FILE
    if not path.exists():
        raise DatasetError(f"{path}: missing, so nothing says what code {folder.name} is of")
    return Origin(**json.loads(path.read_text("utf-8")))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("methods", nargs="*")
    args = options.parse_args()
    stamp(args.folder, args.methods)


if __name__ == "__main__":
    main()
