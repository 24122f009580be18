"""Run all targets, or those named, each for some seconds: ``python run.py SECONDS [TARGET...]``."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
TARGETS = ("scans", "trajectories", "messages", "bags", "layouts", "node", "weights", "texts")


def main(seconds: str, targets: list[str]) -> int:
    inputs, faults = 0, 0
    for target in targets or TARGETS:
        command = [sys.executable, str(HERE / f"{target}.py"), seconds]
        done = subprocess.run(command, stderr=subprocess.PIPE, text=True, errors="replace")
        found = done.stderr.count("FOUND ")
        count = re.search(r"stat::number_of_executed_units: +(\d+)", done.stderr)
        memory = re.search(r"stat::peak_rss_mb: +(\d+)", done.stderr)
        print(
            f"{target}: {count[1] if count else '?'} inputs, {found} faults, "
            f"{memory[1] if memory else '?'} MB, exit {done.returncode}",
            flush=True,
        )
        if found or done.returncode or not count:
            print(done.stderr[-6000:])
        inputs += int(count[1]) if count else 0
        faults += found + (done.returncode != 0)
    print(f"{inputs} inputs, {faults} faults")
    return min(faults, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else "60", sys.argv[2:]))
