"""A wheel in an empty environment: what `segloc` does there, and how long it takes.

    python3.12 packaging/tried.py build/wheel/segloc-*.whl

With the Python that runs it. `segloc` alone writes the sample, maps and localizes it, and runs the
demo, without pictures. Prints a row of Markdown; times are of the processor.
"""

from __future__ import annotations

import json
import platform
import sys
import tempfile
from pathlib import Path

from sizes import seconds


def row(wheel: Path) -> str:
    """What was found, and the times."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seconds(sys.executable, "-m", "venv", folder / "alone")
        binaries = folder / "alone" / "bin"
        seconds(binaries / "python", "-m", "pip", "install", "--quiet", wheel.resolve())
        segloc = binaries / "segloc"
        sample, site, out = folder / "sample", folder / "site.segmap", folder / "out"
        seconds(segloc, "sample", "--out", sample)
        poses = ["--poses", "poses.tum"]
        mapped = seconds(segloc, "map", "build", sample / "monday", *poses, "--out", site)
        query = ["localize", sample / "tuesday", "--map", site, "--truth", "poses.tum"]
        localized = seconds(segloc, *query, "--threads", 1, "--out", out)
        summary = json.loads((out / "summary.json").read_text())
        shown = seconds(segloc, "demo", "--out", folder / "shown")
        found = f"{summary['correct']} of {summary['queries']}, {summary['false']} falsely"
        times = [f"{time:.0f} s" for time in (mapped, localized, shown)]
        label = f"{platform.python_version()}, `{'-'.join(wheel.stem.split('-')[2:4])}`"
        return " | ".join(["", label, times[0], times[1], found, times[2], ""]).strip()


if __name__ == "__main__":
    print(row(Path(sys.argv[1])))
