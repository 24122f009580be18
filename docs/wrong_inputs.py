"""Write the messages for faulty recordings: the table of docs/reference/messages.md.

python docs/wrong_inputs.py            # write the table between its markers
python docs/wrong_inputs.py --check    # exit status 1 if it is stale

Each row is a recording of a simulated square with one fault, given to a verb as it is.
"""

from __future__ import annotations

import argparse
import io
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from segloc import geometry
from segloc.tools.io import Trajectory, write_tum
from segloc.types import Float64

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from samples.plaza import Plaza, PlazaSequence  # noqa: E402
from samples.walk import Walk, run  # noqa: E402

PAGE = ROOT / "docs" / "reference" / "messages.md"
BEGIN, END = "<!-- begin wrong inputs -->", "<!-- end wrong inputs -->"
T_CAMERA_SENSOR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
TILT_DEG = 15.0

Points = Callable[[Float64], Float64]
Poses = Callable[[Float64], Float64]


class Wrong(NamedTuple):
    """One thing that is wrong: of the points, or of the poses."""

    what: str
    points: Points = lambda points: points
    poses: Poses = lambda poses: poses
    posed: bool = True


def _turned(axis: str, degrees: float) -> Points:
    R = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda points: points @ R.T


def _scalar_first(poses: Float64) -> Float64:
    made = poses.copy()
    rolled = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    made[:, :3, :3] = Rotation.from_quat(rolled).as_matrix()
    return made


def _in_millimetres(poses: Float64) -> Float64:
    made = poses.copy()
    made[:, :3, 3] *= 1000.0
    return made


WRONG = (
    Wrong("points in millimetres", lambda p: 1000.0 * p),
    Wrong("z points down", lambda p: p * [1.0, -1.0, -1.0]),
    Wrong("a camera's axes: z forward", lambda p: geometry.transform(T_CAMERA_SENSOR, p)),
    Wrong("points in world coordinates", lambda p: p + [455e3, 5428e3, 110.0]),
    Wrong(
        f"a sensor tilted by {TILT_DEG:.0f} degrees, no poses", _turned("y", TILT_DEG), posed=False
    ),
    Wrong("a sensor on its side", _turned("y", 90.0)),
    Wrong("rotations as qw qx qy qz", poses=_scalar_first),
    Wrong("inverse poses", poses=lambda T: np.linalg.inv(T)),
    Wrong(
        "poses of a camera",
        poses=lambda T: T_CAMERA_SENSOR @ T @ np.linalg.inv(T_CAMERA_SENSOR),
    ),
    Wrong("poses in millimetres", poses=_in_millimetres),
    Wrong("poses in another order", poses=lambda T: T[::-1].copy()),
)


def write(folder: Path, wrong: Wrong) -> None:
    """A walk across the square with something wrong, as a folder of scans with poses.tum."""
    folder.mkdir()
    walk = Walk(wrong.points)
    for i in range(len(walk)):
        np.save(folder / f"{i:04d}.npy", walk.scan(i).points)
    if wrong.posed:
        write_tum(folder / "poses.tum", Trajectory(np.arange(len(walk)), wrong.poses(walk.poses)))


def output_of(*arguments: object) -> tuple[int, str]:
    """Return the exit status of a verb and its output."""
    text = io.StringIO()
    with redirect_stdout(text), redirect_stderr(text):
        status = run(*arguments)
    return status, text.getvalue()


class Row(NamedTuple):
    """A row of the table."""

    what: str
    verb: str
    status: int
    sentence: str
    also: str = ""
    """Which other verbs say the same."""


def rows(work: Path) -> Iterator[Row]:
    """Return the table of faults and their messages."""
    prior_map = work / "site.segmap"
    write(work / "right", Wrong("nothing"))
    output_of("map", "build", work / "right", "--poses", "poses.tum", "--out", prior_map)
    for k, wrong in enumerate(WRONG):
        write(work / str(k), wrong)
        poses = ["--poses", "poses.tum"] if wrong.posed else []
        status, text = output_of("doctor", work / str(k), *poses)
        wrongs = [line for line in text.splitlines() if line.startswith("problem: ")]
        if len(wrongs) != 1:
            raise SystemExit(f"{wrong.what}: one sentence must name it, not {wrongs}")
        building = ["map", "build", work / str(k), *poses, "--out", work / "wrong.segmap"]
        asking = ["localize", work / str(k), *poses, "--map", prior_map]
        heard = {"map build": output_of(*building), "localize": output_of(*asking)}
        also = [
            f"`segloc {verb}` ({code})"
            for verb, (code, told) in heard.items()
            if _without_figures(wrongs[0].removeprefix("problem: ")) in _without_figures(told)
        ]
        yield Row(wrong.what, "doctor", status, wrongs[0], ", ".join(also))
    yield from _other_places(work)


def _without_figures(text: str) -> str:
    """Which differ with the scans that are looked at."""
    return re.sub(r"-?\d+(\.\d+)?", "#", " ".join(text.split()))


def _other_places(work: Path) -> Iterator[Row]:
    """Yield rows of two places taken for one, and of two frames."""
    from segloc import Config, build_map

    for seed in (1, 2):
        built = build_map(PlazaSequence(Plaza(seed, objects=40), steps=8), Config.preset("geo"))
        built.save(work / f"{seed}.segmap")
    write(work / "there", Wrong("nothing"))
    first, second, out = work / "1.segmap", work / "2.segmap", work / "both.segmap"
    session = [work / "there", "--poses", "poses.tum", "--out", out]
    for what, verb, given in (
        ("a map of another place merged", "map merge", [first, second, "--out", out]),
        ("a map updated with another place", "map update", [second, *session]),
    ):
        status, text = output_of(*verb.split(), *given)
        yield Row(what, verb, status, text.strip().splitlines()[-1].replace(f"{work}/", ""))
    write(work / "off", Wrong("", poses=lambda T: geometry.yaw_transform(0.0, (2.0, 0, 0)) @ T))
    given = [work / "site.segmap", work / "off", "--poses", "poses.tum", "--out", out]
    status, text = output_of("map", "update", *given)
    sentence = text.strip().splitlines()[-1].replace(f"{work}/", "")
    yield Row("a session 2 m off the map", "map update", status, sentence)


def table() -> str:
    with TemporaryDirectory() as folder:
        lines = [
            f"| {row.what} | `segloc {row.verb}` | {row.status} | "
            f"{row.sentence.replace('|', '&#124;')} | {row.also} |"
            for row in rows(Path(folder))
        ]
    head = "| fault | verb | exit status | message | also reported by (exit status) |\n"
    return head + "|---|---|---|---|---|\n" + "\n".join(lines) + "\n"


def kept(page: str) -> str:
    """The table that a page has."""
    found = re.search(f"{BEGIN}\n.*?{END}", page, re.DOTALL)
    if found is None:
        raise SystemExit(f"{PAGE}: has no {BEGIN}")
    return found[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    options = parser.parse_args()
    page, made = PAGE.read_text("utf-8"), f"{BEGIN}\n{table()}{END}"
    if options.check and kept(page) != made:
        raise SystemExit("docs/reference/messages.md is stale: run python docs/wrong_inputs.py")
    if not options.check:
        PAGE.write_text(page.replace(kept(page), made), "utf-8")


if __name__ == "__main__":
    main()
