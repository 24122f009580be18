"""Follow robots by any version of segloc, in a process of its own.

As a script it imports nothing but ``segloc``, and runs with whatever version an interpreter has:

    python -m segloc_lab.protocols.follower

Its stdin and stdout carry pickles: the scans of a map and their poses, then None for a new robot or
what arrives, for which the state of the robot and processor times are returned.
"""

from __future__ import annotations

import argparse
import pickle
import subprocess
import sys
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import segloc
from segloc.errors import InvalidScan
from segloc.live import LiveCore, State, Status

Taken = tuple[State, float, tuple[float, ...]]
FIELDS = ("stamp", "T_map_odom", "T_odom_base", "covariance")


class Follower:
    """A map, and one robot at a time, of the version that an interpreter has.

    Parameters
    ----------
    python : Path
        The interpreter.
    scans : sequence of (points, T_map_sensor)
        Of the map.

    Attributes
    ----------
    version : str
    """

    def __init__(self, python: Path, scans: Sequence[tuple[Any, Any]]) -> None:
        given = [str(python), "-I", __file__]
        self._process = subprocess.Popen(given, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        weakref.finalize(self, ended, self._process)
        self.version: str = self._call(scans)

    def start(self) -> None:
        """Switch on another robot."""
        self._call(None)

    def take(self, stamp: float, points: Any, T_odom_sensor: Any) -> Taken:
        """Return what :func:`taken` does, of that version."""
        found, *times = self._call((stamp, points, T_odom_sensor))
        return State(**found | {"status": Status(found["status"])}), *times

    def _call(self, what: Any) -> Any:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        pickle.dump(what, stdin)
        stdin.flush()
        return pickle.load(stdout)


def ended(process: subprocess.Popen[bytes]) -> None:
    """End a follower: there is nothing more to read."""
    process.communicate()


def taken(core: LiveCore, stamp: float, points: Any, T_odom_sensor: Any) -> Taken:
    """Return the state after a scan, the odometry, or both, with the queries that are due.

    With the processor times of scan and odometry, and of each query [ms].
    """
    begun = time.process_time()
    if T_odom_sensor is not None:
        with suppress(InvalidScan):  # as a node does
            core.add_odometry(stamp, T_odom_sensor)
    if points is not None:
        core.add_scan(segloc.Scan(points), stamp)
    ends = [time.process_time()]
    while (asked := core.due()) is not None:
        core.answer(asked, core.ask(asked))
        ends.append(time.process_time())
    return core.state, 1e3 * (ends[0] - begun), tuple(1e3 * np.diff(ends))


def main() -> None:
    shown = argparse.RawDescriptionHelpFormatter
    argparse.ArgumentParser(description=__doc__, formatter_class=shown).parse_args()
    answers, sys.stdout = sys.stdout.buffer, sys.stderr
    read = partial(pickle.load, sys.stdin.buffer)
    answer: Any = segloc.__version__
    config = segloc.Config(threads=1)
    mapped = [segloc.Scan(points, T_odom_sensor=T) for points, T in read()]
    localizer = segloc.Localizer(segloc.build_map(segloc.MemoryRecording(mapped), config), config)
    while True:
        pickle.dump(answer, answers)
        answers.flush()
        arrived = read()
        if arrived is None:
            core, answer = LiveCore(localizer, T_base_sensor=np.eye(4)), None
        else:
            state, *times = taken(core, *arrived)
            known = {name: getattr(state, name) for name in FIELDS}
            answer = ({**known, "status": str(state.status)}, *times)


if __name__ == "__main__":
    with suppress(EOFError):
        main()
