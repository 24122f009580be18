"""The page of public sets: its paths are those of the layouts, its files of truth are read."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from samples.datasets import (
    FLIP,
    Drive,
    boreas,
    helipr,
    kitti,
    kitti_raw,
    mulran,
    nclt,
    newer_college,
    nuscenes,
    us,
    wild_places,
)
from samples.documents import code
from samples.robotcar import write_ins, write_sweep
from samples.source import PROJECT

from segloc import geometry
from segloc.tools.datasets import open_sequence, poses_at
from segloc.tools.datasets.formats import FORMATS

PAGE = PROJECT / "docs" / "how-to" / "public-sets.md"
DRIVE = Drive.make()


def renamed(write: Callable[[Path, Drive], Path]) -> Callable[[Path, Drive], Path]:
    """Write a recording that is then moved to where the page has it."""

    def placed(goal: Path, drive: Drive) -> Path:
        made = write(goal.parent / "made", drive)
        for file in made.rglob(f"*{made.name}*"):  # NCLT names a file by its session
            file.rename(file.with_name(file.name.replace(made.name, goal.name)))
        goal.parent.mkdir(parents=True, exist_ok=True)
        return Path(shutil.move(made, goal))

    return placed


def kitti_360(goal: Path, drive: Drive) -> Path:
    """KITTI raw's scans, and poses numbered by scan, here of the sensor itself."""
    made = renamed(kitti_raw)(goal, drive)
    poses = goal.parents[1] / "data_poses" / goal.name / "poses.txt"
    poses.parent.mkdir(parents=True)
    rows = [f"{i} {' '.join(map(str, T[:3].ravel()))}" for i, T in enumerate(drive.poses)]
    poses.write_text("\n".join(rows))
    return made


def robotcar(goal: Path, drive: Drive) -> Path:
    """A sweep of the front scanner, and a scan of the left Velodyne, for each pose of the car."""
    for stamp in drive.stamps:
        write_sweep(goal / "lms_front", stamp, drive.landmarks[:, :2])
        scan = goal / "velodyne_left" / f"{us(stamp)}.bin"
        scan.parent.mkdir(exist_ok=True)
        rows = np.column_stack([drive.landmarks, np.ones(len(drive.landmarks))]).T
        scan.write_bytes(rows.astype("<f4").tobytes())
    (goal / "gps").mkdir()
    name = "ins" if "radar" in goal.name else "rtk"
    poses = FLIP @ drive.poses @ FLIP
    write_ins(goal / "gps" / f"{name}.csv", drive.stamps, poses, status=name == "ins")
    return goal


def helipr_all(root: Path, drive: Drive) -> Path:
    return helipr(root, drive, "Ouster", "Velodyne")


WRITERS: dict[str, Callable[[Path, Drive], Path]] = {
    "dataset": lambda goal, drive: kitti(goal.parents[1], drive),
    "2011_10_03": lambda goal, drive: kitti_raw(goal.parents[1], drive),
    "KITTI-360": kitti_360,
    "nuscenes": nuscenes,
    "DCC": renamed(mulran),
    "Roundabout": renamed(helipr_all),
    "2012": renamed(nclt),
    "2014": robotcar,
    "2019": robotcar,
    "boreas": renamed(boreas),
    "0": renamed(newer_college),
    "Venman": renamed(wild_places),
}
"""By how the paths of the page begin."""


def commands() -> Iterator[tuple[str, dict[str, str]]]:
    """Paths of recordings and the options they are given, command by command."""
    for each in code(PAGE):
        words = each.text.split()
        path = words[3] if words[1] == "map" else words[2]
        given = {a: b for a, b in pairwise(words) if a.startswith("--")}
        if words[1] in ("map", "localize"):
            yield path, given


@pytest.mark.parametrize(("path", "given"), list(commands()), ids=lambda each: str(each)[:40])
def test_a_set_is_read_as_its_command_names_it(
    path: str, given: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = next(w for name, w in WRITERS.items() if path.startswith(name))
    monkeypatch.chdir(tmp_path)
    write(tmp_path / path, DRIVE)
    sequence = open_sequence(path, given.get("--poses"), topic=given.get("--topic"))
    assert len(sequence) == len(DRIVE.stamps)
    if given.get("--poses") == "none":
        assert sequence.poses is None
    if "--truth" in given:
        found = poses_at(sequence, Path(path), Path(given["--truth"]), given.get("--topic"))
    elif sequence.poses is not None:
        found = sequence.poses
    else:
        return
    steps = geometry.inverse(DRIVE.poses[0]) @ DRIVE.poses
    np.testing.assert_allclose(geometry.inverse(found[0]) @ found, steps, atol=2e-5)


def test_every_set_with_a_reader_is_on_the_page() -> None:
    text = PAGE.read_text("utf-8")
    sets = {each.NAME for each in FORMATS if each.__name__.split(".")[-2] == "loaders"}
    assert len(sets) >= 10
    missing = {name for name in sets if f"[{name}]" not in text}
    assert not missing
