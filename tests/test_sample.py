"""The recorded sample: the same points everywhere, and the drives of its README."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from segloc import DatasetError, sample
from segloc.tools.datasets.recorded import parse_select

POINTS = "cac3cfa848c5d204fb3c2bc9a575f85fe15179057b31d99edce1a6b1e5f7015c"


@pytest.fixture(scope="module")
def drives() -> dict[sample.Name, sample.SampleDrive]:
    return {name: sample.load(name) for name in ("monday", "tuesday", "elsewhere")}


def test_points_are_the_same_bits_on_every_machine(
    drives: dict[sample.Name, sample.SampleDrive],
) -> None:
    """Record the sample anew: then this hash changes, too."""
    found = hashlib.sha256()
    for drive in drives.values():
        for i in range(len(drive)):
            points = drive.scan(i).points
            assert np.isfinite(points).all() and len(points) > 5000
            found.update(np.ascontiguousarray(points, dtype="<f4").tobytes())
    assert found.hexdigest() == POINTS


def test_poses_of_queries_are_odometry(drives: dict[sample.Name, sample.SampleDrive]) -> None:
    assert np.array_equal(drives["monday"].poses, drives["monday"].truth)
    for name in ("tuesday", "elsewhere"):
        drive = drives[name]  # type: ignore[index]
        steps, truth = (
            np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) for T in (drive.poses, drive.truth)
        )
        assert np.allclose(steps, truth, atol=0.2) and np.abs(steps - truth).max() > 0.005
        assert (np.diff(drive.stamps) > 0).all()


def test_a_selection_has_the_same_scans(drives: dict[sample.Name, sample.SampleDrive]) -> None:
    part = drives["tuesday"].select(parse_select("3:5"))
    assert part.indices.tolist() == [3, 4, 5]
    scan, whole = part.scan(1), drives["tuesday"].scan(4)
    assert np.array_equal(scan.points, whole.points) and scan.stamp == whole.stamp
    with pytest.raises(DatasetError, match="no scan at position 3"):
        part.scan(3)


@pytest.mark.parametrize("kept", [0, 4000, 900_000])
def test_a_damaged_file_is_named(
    kept: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = bytearray((sample.FOLDER / "monday.npz").read_bytes())
    content[kept : kept + 200] = bytes(200)
    (tmp_path / "monday.npz").write_bytes(content)
    monkeypatch.setattr(sample, "FOLDER", tmp_path)
    with pytest.raises(DatasetError, match=r"monday\.npz: cannot be read: reinstall segloc"):
        sample.load("monday")
