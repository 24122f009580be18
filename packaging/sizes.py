"""What an installation downloads and takes, and how long it is until something happens.

    python packaging/sizes.py build/wheel/segloc-*.whl [EXTRA[,EXTRA]...]

For segloc alone and with each set of extras an environment is made and left again; prints Markdown.
Times are of the processor (user and system), as a busy machine does not change them much: install
without the download, `import segloc`, `segloc --help`.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

REPEATS = 5


def size(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def seconds(*command: object) -> float:
    """Processor time of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def least(*command: object) -> float:
    """Of several runs: the others met a cold cache, or a busy machine."""
    return min(seconds(*command) for _ in range(REPEATS))


def row(wheel: Path, extras: str) -> str:
    """A row of the table."""
    with tempfile.TemporaryDirectory() as name:
        files, venv = Path(name) / "files", Path(name) / "venv"
        wanted = f"{wheel.resolve()}[{extras}]" if extras else str(wheel.resolve())
        pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
        seconds(*pip, "download", "--dest", files, wanted)
        seconds(sys.executable, "-m", "venv", "--without-pip", venv)
        python = venv / "bin" / "python"
        bare = size(venv)
        into = [*pip, "--python", python, "install", "--no-index", "--find-links", files]
        install = seconds(*into, wanted)
        taken = size(venv) - bare
        start = least(python, "-c", "pass")
        times = [least(python, "-c", "import segloc") - start]
        times += [least(python, "-c", "from segloc import Localizer, SegmentMap") - start]
        times += [least(venv / "bin" / "segloc", "--help")]
        label = f"`segloc[{extras}]`" if extras else "`segloc`"
        cells = [label, f"{size(files) / 1e6:.0f} MB", f"{taken / 1e6:.0f} MB", f"{install:.0f} s"]
        return " | ".join(["", *cells, *(f"{time:.2f} s" for time in times), ""]).strip()


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("extras", nargs="*", help="sets, each joined by commas")
    given = parser.parse_args()
    columns = ("download", "on disk", "install", "`import segloc`", "with `Localizer`", "`--help`")
    print("| installed |", " | ".join(columns), "|")
    print("|---" * (len(columns) + 1) + "|")
    for extras in ["", *given.extras]:
        print(row(given.wheel, extras), flush=True)


if __name__ == "__main__":
    main()
