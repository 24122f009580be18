"""Recordings whose bytes were flipped or cut off anywhere: one clear line, or scans; never else."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from samples.datasets import Drive, bag_writer, kitti, mulran, nclt
from samples.robotcar import write_ins, write_sweep

from segloc.errors import SeglocError
from segloc.tools.datasets import open_sequence

DRIVE = Drive.make(3, 40)
EXAMPLES = settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
harms = st.tuples(
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=6),
    st.none() | st.floats(0, 1),
)


def robotcar(root: Path, drive: Drive) -> Path:
    folder = root / "2014-11-14-16-34-33"
    for stamp in drive.stamps:
        write_sweep(folder / "lms_front", stamp, drive.landmarks[:, :2])
    write_ins(folder / "gps" / "ins.csv", drive.stamps, drive.poses)
    return folder


def bag(kind: str, root: Path, drive: Drive) -> Path:
    writer = bag_writer(kind)
    for i, stamp in enumerate(drive.stamps):
        times = ("t", "u4", np.arange(40.0))
        writer.cloud("/points", stamp, drive.seen(i), times=times)
        writer.odometry("/odom", stamp, drive.poses[i], "lidar")
        writer.tf("/tf", stamp, drive.poses[i], "map", "odom")
    return writer.write(root / "drive")


def velodyne(root: Path, drive: Drive) -> Path:
    pytest.importorskip("velodyne_decoder")
    from samples.velodyne import capture, packets

    return capture(root / "drive.pcap", packets(2.0))


def ouster(root: Path, drive: Drive) -> Path:
    from samples.ouster import Ouster, recorded

    return recorded(root / "drive.pcap", Ouster(), 2)


WRITERS: dict[str, Callable[[Path, Drive], Path]] = {
    "kitti": kitti,
    "mulran": mulran,
    "nclt": nclt,
    "robotcar": robotcar,
    "ros1": partial(bag, "ros1"),
    "sqlite3": partial(bag, "sqlite3"),
    "mcap": partial(bag, "mcap"),
    "velodyne": velodyne,
    "ouster": ouster,
}


def harmed(content: bytes, flips: list[tuple[float, int]], kept: float | None) -> bytes:
    """The bytes with some changed, cut off behind a share of them."""
    changed = bytearray(content)
    for where, mask in flips:
        if changed:
            changed[int(where * len(changed))] ^= mask
    return bytes(changed[: len(changed) if kept is None else int(kept * len(changed))])


def read_all(path: Path) -> None:
    """Open and read what is there; faults take one line."""
    try:
        sequence = open_sequence(path)
    except SeglocError as error:
        check(error)
        return
    for i in range(min(len(sequence), 20)):
        try:
            assert np.isfinite(sequence.scan(i).points).all()
        except SeglocError as error:
            check(error)


def check(error: SeglocError) -> None:
    assert str(error)
    assert "\n" not in str(error)
    assert len(str(error)) < 1000


@pytest.fixture(scope="module", params=WRITERS)
def sample(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[Path, bytes]]:
    """A recording and the bytes of its files."""
    path = WRITERS[request.param](tmp_path_factory.mktemp("fuzz"), DRIVE)
    places = [path, *path.parent.glob("*.json")] if path.is_file() else path.rglob("*")
    return path, {file: file.read_bytes() for file in places if file.is_file()}


@pytest.mark.slow
@EXAMPLES
@given(harm=harms, which=st.integers(0, 10**6))
def test_damage_anywhere(
    sample: tuple[Path, dict[Path, bytes]],
    harm: tuple[list[tuple[float, int]], float | None],
    which: int,
) -> None:
    path, files = sample
    file = sorted(files)[which % len(files)]
    file.write_bytes(harmed(files[file], *harm))
    try:
        read_all(path)
    finally:
        file.write_bytes(files[file])
