"""A wheel in an empty environment: what `segloc` does there, and how long it takes.

    python3.12 packaging/tried.py build/wheel/segloc-*.whl

With the Python that runs it. `segloc` alone maps and localizes what the simulator made, whose extra
is only then there; then comes the demo. Prints a row of Markdown; times are of the processor.
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
        for environment, extras in (("alone", ""), ("demo", "[demo]")):
            seconds(sys.executable, "-m", "venv", folder / environment)
            pip = [folder / environment / "bin" / "python", "-m", "pip", "install", "--quiet"]
            seconds(*pip, f"{wheel.resolve()}{extras}")
        alone, demo = (folder / each / "bin" / "segloc" for each in ("alone", "demo"))
        sample, site, out = folder / "sample", folder / "site.segmap", folder / "out"
        seconds(demo, "sample", "--out", sample, "--workers", 1)
        poses = ["--poses", "poses.tum"]
        mapped = seconds(alone, "map", "build", sample / "monday", *poses, "--out", site)
        query = ["localize", sample / "tuesday", "--map", site, "--truth", "poses.tum"]
        localized = seconds(alone, *query, "--threads", 1, "--out", out)
        summary = json.loads((out / "summary.json").read_text())
        shown = seconds(demo, "demo", "--out", folder / "shown")
        found = f"{summary['correct']} of {summary['queries']}, {summary['false']} falsely"
        times = [f"{time:.0f} s" for time in (mapped, localized, shown)]
        label = f"{platform.python_version()}, `{'-'.join(wheel.stem.split('-')[2:4])}`"
        return " | ".join(["", label, times[0], times[1], found, times[2], ""]).strip()


if __name__ == "__main__":
    print(row(Path(sys.argv[1])))
