"""Every block of Python and every command of the documents runs, at its smallest size.

What does not is listed in ``NOT_RUN``, with the reason; that of a whole page, in ``PAGES``.
"""

from __future__ import annotations

import re
import shlex
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from samples.documents import Code, code, documents
from samples.source import PROJECT
from samples.walk import run
from samples.workplace import Steps, furnish

import segloc
from segloc import Localizer, Scan, SegmentMap, geometry

LABORATORY = "measures for minutes to hours, most of it on real scans: its module is there"

NOT_RUN = {
    r"pip install": "installs: `make wheel-check` does so",
    r"python3 -m venv|\. ": "sets up an environment",
    r"git clone": "fetches from elsewhere",
    r"cd ": "of the command before it",
    r"python -m segloc_lab": LABORATORY,
    r"(lab/src/)\S+\.sh": LABORATORY,
    r"segloc bench": LABORATORY,
    r"segloc localize .*--gnss": "needs a bag with fixes; in tests/test_gnss.py",
    r"segloc map (update|merge) (tiles|.* tiles)": "of sessions of the reader's; in tests/tiles",
    r"segloc .*--report": LABORATORY,
    r"segloc evaluate (all|report|peers)": LABORATORY,
    r"segloc evaluate localization .*--kitti": LABORATORY,
    r"segloc simulate --suite": "six places, a quarter of an hour; of them lab/tests/simulation",
    r"segloc (train|map|localize|align) .*(kitti|METHOD|2014|worlds|others|harbour|RUN RUN)": (
        "needs a large dataset; each option is tried in lab/tests/cli/test_train.py"
    ),
    r"segloc train (extract|profile)": "minutes; at their smallest in lab/tests/cli/test_train.py",
    r"segloc simulate (building|industrial|forest|offices)": (
        "minutes; in lab/tests/cli/test_simulate.py"
    ),
    r"segloc (map build|map from-mesh|localize) runs/": "of what the line before simulates",
    r"segloc .*(--install-completion|--show-completion)": "changes the reader's shell",
    r"segloc .*--cluster": "needs a cluster; one is made in tests/map",
    r"segloc .*(gs://|s3://|https://)": "needs a bucket",
    r"ros2 |colcon |docker ": "needs ROS or a robot",
}
"""Commands that are not run, by how they begin, and why."""

PAGES = {
    "docs/how-to/train.md": "its commands train for hours; smallest in lab/tests/cli/test_train.py",
    "docs/how-to/robot.md": "needs a robot",
    "docs/how-to/public-sets.md": "needs large sets; their layouts in tests/tools/datasets/loaders",
    "docs/how-to/fleet.md": "needs a cluster",
}
"""Pages of which nothing is run."""

SMALLER: tuple[tuple[str, str], ...] = (
    (r" \[(--[^]]*)\]", r" \1"),
    (r"--odometry\b", "--poses {bag_poses}"),
    (r"RECORDING|SEQUENCE", "monday"),
    (r"--poses FILE", "--poses poses.tum"),
    (r"--every 5\b", "--every 6"),
    (r"/elsewhere/poses.tum", "poses_elsewhere.tum"),
    (r"--kitti DATA", ""),
    (r"(segloc align .*) friday/", r"\1"),
    (r"(segloc localize sample/tuesday .*)", r"\1 --select :4"),
    (r"(segloc evaluate localization .*)", r"\1 --methods geo --workers 1 --every 4"),
    (r"(segloc live .*)--rate 1 ", r"\1--rate 20 "),
    (r"(segloc odometry drive.bag)$", r"\1 --out drive.bag.odometry.tum"),
    (r"(segloc odometry drive.bag)", r"\1 --select :1"),
    (r"(segloc explain .*)--select 412", r"\1--select 4"),
    (r"survey.laz|tuesday/0412.pcd", "scan.pcd"),
    (r"(monday|tuesday)/scans", r"\1"),
    (r"--select 0:170", "--select 0:6"),
    (r"--select 171:", "--select 5:"),
)
"""What is written shorter, or where recordings of the reader's are meant, others."""

FEWER = (
    ("rng, [0], 300.0", "rng, [0], 30.0"),
    ("town(seed=7)", "town(seed=7, size_m=150.0)"),
    ("hdl64e(900)", "hdl64e(60)"),
    ("hdl64e()", "hdl64e(60)"),
)
"""Likewise in Python."""

FINDS_FAULTS = re.compile(r"segloc doctor")
"""May end with 1: it reports faults."""

_PICTURE = re.compile(r"`(\w+/\w+\.png)`")


class Item(NamedTuple):
    """A scan of a stream, as the documents take it apart."""

    points: Any
    T_odom_sensor: Any


class Message(Item):
    """The same as a message of a robot."""

    is_odometry = False
    stamp = 0.0
    times = None


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    pytest.importorskip("rosbags", reason="recordings of the documents are bags")
    yield furnish(tmp_path_factory.mktemp("work"))


@pytest.fixture(scope="module")
def done() -> set[str]:
    """Commands that ran: repetitions on other pages are skipped."""
    return set()


def reason(text: str) -> str | None:
    return next((why for start, why in NOT_RUN.items() if re.match(start, text)), None)


def smaller(text: str) -> str:
    for pattern, replacement in SMALLER:
        text = re.sub(pattern, replacement, text)
    named = re.search(r"(\w+)\.bag", text)
    poses = "poses.tum" if named is None else "tuesday.tum"
    if "align" in text:
        poses = "monday.tum"
    return text.replace("{bag_poses}", poses)


def arguments(text: str) -> list[str]:
    words = [word for word in shlex.split(text)[1:] if word]
    return [each for word in words for each in _expanded(word)]


def _expanded(word: str) -> list[str]:
    found = sorted(map(str, Path().glob(word))) if "*" in word else []
    return found or [word]


@pytest.fixture
def without_servers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Servers are not started."""
    from segloc.tools.inspect import viewer

    server = types.SimpleNamespace(get_port=lambda: 8080, sleep_forever=lambda: None)
    monkeypatch.setattr(viewer, "serve", lambda *_: server)
    monkeypatch.setattr(viewer, "follow", lambda *_: server)


@pytest.mark.slow
@pytest.mark.parametrize("path", documents(), ids=lambda path: str(path.relative_to(PROJECT)))
def test_the_code_of_a_page_runs(
    path: Path,
    place: Path,
    done: set[str],
    monkeypatch: pytest.MonkeyPatch,
    without_servers: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if str(path.relative_to(PROJECT)) in PAGES:
        pytest.skip(PAGES[str(path.relative_to(PROJECT))])
    monkeypatch.chdir(place)
    names: dict[str, Any] | None = None
    for each in code(path):
        if each.language == "python":
            names = names or known(place)
            text = each.text
            for usual, little in FEWER:
                text = text.replace(usual, little)
            exec(compile(text, each.place, "exec"), names)
        elif reason(each.text) is None:
            assert each.text.startswith(("segloc ", "SEGLOC_")), f"{each.place}: {each.text}"
            check(each, capsys, done)
    for picture in _PICTURE.findall(path.read_text("utf-8")):
        assert Path(picture).is_file(), f"{path}: its commands draw no {picture}"


def check(each: Code, capsys: pytest.CaptureFixture[str], done: set[str]) -> None:
    text = smaller(re.sub(r"^SEGLOC_\w+=\S+ ", "", each.text))
    if text in done:
        return
    status = run(*arguments(text))
    output = capsys.readouterr()
    allowed = (0, 1) if FINDS_FAULTS.match(text) else (0,)
    assert status in allowed, f"{each.place}: {text}\n{output.err[-2000:]}"
    assert "segloc: error" not in output.err, f"{each.place}: {text}\n{output.err[-2000:]}"
    done.add(text)


def test_every_exception_is_needed() -> None:
    found = [each.text for path in documents() for each in code(path)]
    unused = [start for start in NOT_RUN if not any(re.match(start, text) for text in found)]
    later = {r"ros2 |colcon |docker ", r"segloc .*(gs://|s3://|https://)", r"segloc .*--cluster"}
    later |= {r"segloc .*(--install-completion|--show-completion)", r"git clone", r"cd "}
    assert set(unused) <= later


def test_what_measures_is_there() -> None:
    """Modules and scripts that are named and not run."""
    pytest.importorskip("segloc_lab")
    from importlib.util import find_spec

    for path in documents():
        for each in code(path):
            if found := re.search(r"python -m (segloc_lab\S+)", each.text):
                spec = find_spec(found[1])
                assert spec is not None and spec.origin, f"{each.place}: {found[1]}"
                runs = '__name__ == "__main__"' in Path(spec.origin).read_text("utf-8")
                assert runs, f"{each.place}: {found[1]} is no script"
            if found := re.match(r"(lab/\S+\.sh)", each.text):
                assert (PROJECT / found[1]).is_file(), f"{each.place}: {found[1]}"


def known(place: Path) -> dict[str, Any]:
    """The names that the blocks take as given: a stream of scans, a map, what a robot has."""
    from segloc.tools.datasets import open_sequence

    first = Steps()
    stream = [Message(first.seen(k), T) for k, T in enumerate(first.poses)]
    for k, message in enumerate(stream):
        message.stamp = 10.25 + k  # type: ignore[misc]
        message.times = None
    localizer = Localizer(SegmentMap.load(place / "site.segmap"))
    monday = open_sequence(place / "monday", place / "monday" / "poses.tum")
    return {
        **{name: getattr(segloc, name) for name in ("Scan", "Localizer", "SegmentMap")},
        "np": np,
        "points": stream[4].points,
        "scan": Scan(stream[4].points),
        "recent": [(stream[k].points, stream[k].T_odom_sensor) for k in (3, 4)],
        "T_odom_sensor": stream[4].T_odom_sensor,
        "stream": stream,
        "localizer": localizer,
        "mount": np.eye(4),
        "publish": lambda state: None,
        "graph": types.SimpleNamespace(tie=lambda *_: None),
        "better_pose": geometry.yaw_transform(0.0, (0.1, 0.0, 0.0)) @ stream[4].T_odom_sensor,
        "monday": monday,
        "tuesday": monday,
        "positions": np.array([3, 5]),
        "truths": first.poses[[3, 5]],
        "drive": [(Scan(message.points), message.T_odom_sensor) for message in stream[2:5]],
        "query": Scan(stream[4].points),
    }
