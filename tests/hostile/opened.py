"""Opens files in a process with little memory: ``python -m hostile.opened LIST REPORT``.

LIST holds a line of JSON a file, ``[name, how, path]``. REPORT gets one before each,
``["at", name]``, and one behind it, ``[what, text]``: "read" or "refused", or "broken" for whatever
must not happen. A file that takes more than ``LONGEST_S`` of processor time ends the process by the
signal SIGXCPU.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import math
import resource
import sys
import time
from pathlib import Path
from typing import Any, TextIO

MEMORY = 2 << 30
LONGEST_S = 10  # of all threads together, so that a busy machine makes no difference
SCANS = 5  # of a recording that are read


def read_scan(path: Path) -> str:
    import numpy as np

    from segloc.tools.io import read_scan

    scan = read_scan(path)
    assert np.isfinite(scan.points).all()
    assert scan.times is None or scan.times.shape == (len(scan),)
    return f"{len(scan)} points"


def read_sequence(path: Path) -> str:
    import numpy as np

    from segloc.errors import SeglocError
    from segloc.tools.datasets import open_sequence
    from segloc.tools.datasets.inspection import inspect

    recording = open_sequence(path)
    assert recording.poses is None or np.isfinite(recording.poses).all()
    inspect(recording, sample=SCANS)
    faults = []
    for i in range(min(SCANS, len(recording))):
        try:
            assert np.isfinite(recording.scan(i).points).all()
        except SeglocError as error:
            faults.append(one_line(error))
    return f"{len(recording)} scans; {'; '.join([*faults, *recording.notes])}"


def read_trajectory(path: Path) -> str:
    from segloc.tools.io import read_trajectory

    return f"{len(read_trajectory(path))} poses"


def read_weights(path: Path) -> str:
    import inspect

    from segloc.descriptors import create
    from segloc.descriptors.random_forest import PairForest
    from segloc.errors import SeglocError

    assert "weights" in inspect.signature(create).parameters
    faults = []
    for method in ("profile", "dsm", "segmap", "segmatch-eigen"):
        try:
            create(method, 1, path)
        except SeglocError as error:
            faults.append(one_line(error))
    try:
        PairForest.load(path, create("geo", 1))
    except SeglocError as error:
        faults.append(one_line(error))
    if len(faults) == 5:
        raise SeglocError(faults[0])
    return "; ".join(faults)


def read_config(path: Path) -> str:
    from segloc import Config

    return str(Config.load(path).method)


def read_layout(path: Path) -> str:
    """A bag of the layout that the bytes of a file stand for."""
    import tempfile

    from hostile.drawn import write_bag

    with tempfile.TemporaryDirectory() as folder:
        return read_sequence(write_bag(path.read_bytes(), Path(folder)))


def heard_by_node(path: Path) -> str:
    """The messages that a file stands for: each is refused in a line, or its replies are finite."""
    from segloc_ros.core import Robot, Settings
    from segloc_ros.core.diagnosis import diagnose, robot_state

    from hostile.drawn import Draw, messages
    from segloc.errors import SeglocError

    draw, refused = Draw(path.read_bytes()), 0
    values = {
        "trigger": draw.of(("periodic", "until_localized", "service")),
        "odometry": draw.of(("topic", "topic", "tf", "kiss-icp")),
        "mode": draw.of(("both", "tf", "initialpose")),
        "base_to_lidar": draw.of(((), (0.1, 0.2, 1.0, 0.0, 0.0, 0.3))),
        "query_every_m": draw.of((0.0, 5.0)),
        "deadline_ms": 20.0,
        "smooth_tf": draw.below(2) == 0,
        "tf_when_lost": draw.of(("drop", "keep")),
    }
    robot = Robot(Settings.of(values))
    robot.use(_localizer())
    for message in messages(draw):
        try:
            replies = message(robot)
        except SeglocError as error:  # which the node logs
            one_line(error)
            replies, refused = [], refused + 1
        replies = replies if isinstance(replies, list) else []
        while (request := robot.due()) is not None:
            made = None
            with contextlib.suppress(SeglocError):
                made = robot.ask(request)
            replies = [*replies, *robot.answer(request, made)]
        for reply in replies:
            _check_finite(reply)
        assert all(isinstance(text, str) for text in diagnose(robot).values.values())
        assert 0.0 <= robot_state(robot, True).confidence <= 1.0
    return f"{refused} messages refused, found {robot.fixes} times"


@functools.cache
def _localizer() -> Any:
    from hostile.drawn import plaza_walk
    from segloc import Config, Localizer, build_map

    return Localizer(build_map(plaza_walk(), Config.preset("geo")))


def _check_finite(value: Any) -> None:
    """No number of a reply is infinite, or not a number."""
    import numpy as np

    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _check_finite(getattr(value, field.name))
    elif isinstance(value, list | tuple):
        for each in value:
            _check_finite(each)
    elif isinstance(value, float | np.ndarray) and np.asarray(value).dtype.kind == "f":
        assert np.isfinite(value).all(), value


def one_line(error: Exception) -> str:
    text = str(error)
    assert text and "\n" not in text and len(text) <= 4000, text[:500]
    return text


HOW = {
    "scan": read_scan,
    "sequence": read_sequence,
    "trajectory": read_trajectory,
    "weights": read_weights,
    "config": read_config,
    "layout": read_layout,
    "node": heard_by_node,
}


def opened(how: str, path: Path) -> tuple[str, str]:
    """What came of opening a file."""
    from segloc.errors import SeglocError

    try:
        return "read", HOW[how](path)
    except SeglocError as error:
        try:
            return "refused", one_line(error)
        except AssertionError as fault:
            return "broken", f"not one line: {fault}"
    except BaseException as error:
        return "broken", f"{type(error).__name__}: {error}"[:1000]


def limit_processor_time() -> None:
    """End the process when it has computed for so long from now on."""
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time()) + LONGEST_S, most))


def main(listed: Path, report: TextIO) -> None:
    import segloc.tools.cli  # what it needs is loaded before the limit counts

    assert segloc.tools.cli
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for line in listed.read_text().splitlines():
        name, how, path = json.loads(line)
        print(json.dumps(["at", name]), file=report, flush=True)
        limit_processor_time()
        print(json.dumps(opened(how, Path(path))), file=report, flush=True)


if __name__ == "__main__":
    with Path(sys.argv[2]).open("w") as report:
        main(Path(sys.argv[1]), report)
