"""What the targets share: each input is in a file before it runs, and a fault does not end it."""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path

import atheris

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / "tests"), str(PROJECT / "ros2" / "segloc_ros")]
os.environ.setdefault("SEGLOC_MAX_POINTS", "1000000")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
FOUND = PROJECT / "tests" / "hostile" / "found"
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None  # faster than a disk
LONGEST_S = 60  # of the wall: a busy machine takes a while
LARGEST = 4096
"""Bytes of an input, so that what is found can be kept."""

instrumented = atheris.instrument_imports(
    include=["segloc", "segloc_ros", "rosbags.rosbag1", "rosbags.rosbag2", "rosbags.highlevel"],
    enable_loader_override=False,
)


class Bench:
    """Runs inputs, and keeps those that raise what they must not: one for each line that raises.

    Parameters
    ----------
    how : str
        What opens such files in ``hostile.opened``; the folder that faults are kept in.
    """

    def __init__(self, how: str) -> None:
        self._how = how
        self._folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{how}-", dir=MEMORY))
        self._seen: set[tuple[str, str, int]] = set()

    def file(self, name: str, data: bytes) -> Path:
        """The input, on the disk."""
        path = self._folder / name
        path.write_bytes(data)
        return path

    def run(self, path: Path, work: Callable[[], object]) -> None:
        """Do the work; only a SeglocError of one line may come of it."""
        from segloc.errors import SeglocError

        try:
            work()
        except SeglocError as error:
            if "\n" in str(error) or not str(error):
                self._keep(path, error)
        except Exception as error:
            self._keep(path, error)

    def _keep(self, path: Path, error: Exception) -> None:
        last = traceback.extract_tb(error.__traceback__)[-1]
        key = type(error).__name__, last.filename, last.lineno or 0
        if key in self._seen:
            return
        self._seen.add(key)
        kept = FOUND / self._how / f"{type(error).__name__}-{len(self._seen)}-{path.name}"
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(path.read_bytes())
        print(f"FOUND {kept}: {error!r}"[:500], file=sys.stderr)
        traceback.print_exception(error, file=sys.stderr)


def fuzz(
    target: Callable[[bytes], None], seeds: Iterable[bytes], words: Iterable[str] = ()
) -> None:
    """Run the target on inputs grown from the seeds, for the seconds of the command line."""
    corpus = Path(tempfile.mkdtemp(prefix="fuzz-corpus-"))
    for number, seed in enumerate(seeds):
        if len(seed) <= LARGEST:
            (corpus / f"seed-{number}").write_bytes(seed)
    dictionary = corpus.with_suffix(".dict")
    dictionary.write_text("".join(f'"{word}"\n' for word in words) or "# none\n")
    seconds = sys.argv[1] if len(sys.argv) > 1 else "60"
    options = {
        "max_total_time": seconds, "max_len": str(LARGEST), "timeout": str(LONGEST_S),
        "rss_limit_mb": "1024", "print_final_stats": "1", "verbosity": "0", "seed": "1",
        "dict": str(dictionary), "artifact_prefix": f"{corpus}-",
    }  # fmt: skip
    atheris.Setup([sys.argv[0], *(f"-{k}={v}" for k, v in options.items()), str(corpus)], target)
    atheris.Fuzz()
