"""Files as they are found in the wild: each is read right, or refused in one line."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from samples.real import real
from scipy.spatial import cKDTree

from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence
from segloc.tools.io import read_scan
from segloc.tools.io.scans import scan_suffix
from segloc.types import Float64, Scan

pytestmark = pytest.mark.data

OTHERS = {"helipr_avia.bin": "HeLiPR's Avia", "helipr_aeva.bin": "HeLiPR's Aeva"}
"""Files with the suffix of another format, and the format that the error names."""


def files(folder: str) -> Iterator[Path]:
    yield from sorted(path for path in real(folder).rglob("*") if path.is_file())


def plausible(scan: Scan, name: str) -> None:
    """A cloud of something in metres, wider than it is high."""
    assert len(scan) > 10_000, name
    spread = np.ptp(np.percentile(scan.points, [1, 99], axis=0), axis=0)
    assert 1 < spread[2] < 30, name
    assert spread[2] < spread.max() < 250, name


def announced(path: Path) -> set[int]:
    """The numbers of points that a file can have by its own word, found without the readers."""
    data = path.read_bytes()
    if path.suffix == ".laz":
        return {int(struct.unpack_from("<I", data, 107)[0])}
    if path.suffix == ".bin":
        return {len(data) // (4 * width) for width in (3, 4, 5) if len(data) % (4 * width) == 0}
    if path.suffix == ".csv":
        return {data.count(b"\n") - 1}
    found = re.search(rb"^(?:POINTS|element vertex) (\d+)", data, re.M)
    return set() if found is None else {int(found[1])}


@pytest.mark.parametrize("folder", ["formats", "formats_more"])
def test_every_file_of_a_known_suffix_is_read_and_no_other(folder: str) -> None:
    for path in files(folder):
        if path.name in OTHERS:
            fault = f"fit records of {OTHERS[path.name]}.*: open the sequence's folder"
        elif scan_suffix(path) is None:
            fault = "unknown format; supported:"
        else:
            scan = read_scan(path)
            plausible(scan, path.name)
            counts = announced(path)
            given = len(scan) + scan.dropped + scan.missing_returns
            assert not counts or given in counts, path.name
            continue
        with pytest.raises(DatasetError, match=fault) as caught:
            read_scan(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("folder", ["vlp16", "hdl32e", "hdl64_drive", "kitti00/scans"])
def test_scans_have_the_points_that_they_announce(folder: str) -> None:
    pytest.importorskip("laspy")
    path = min(real(folder).glob("*.laz"))
    scan = read_scan(path)
    plausible(scan, path.name)
    assert {len(scan) + scan.dropped} == announced(path)


def test_every_recording_opens_or_is_refused_in_one_line() -> None:
    """Capture, bag, folder or file: by whatever name it is given."""
    for path in sorted(real("formats_more").rglob("*")):
        try:
            sequence = open_sequence(path)
            scan = sequence.scan(0)
        except DatasetError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
        else:
            plausible(scan, path.name)


@pytest.mark.parametrize(
    ("sensor", "width", "azimuth_deg", "elevation_deg"),
    [("Avia", 19, 36, 39), ("Aeva", 29, 61, 16)],
)
def test_records_of_helipr(
    sensor: str, width: int, azimuth_deg: float, elevation_deg: float, tmp_path: Path
) -> None:
    """In the folder of a sequence; points lie where such a sensor looks, times in its period."""
    file = real("formats_more", f"helipr_{sensor.lower()}.bin")
    place = tmp_path / "Roundabout01" / "LiDAR" / sensor / "1691936600000000000.bin"
    place.parent.mkdir(parents=True)
    place.symlink_to(file)
    sequence = open_sequence(tmp_path / "Roundabout01")
    assert (sequence.format, sequence.frame) == ("HeLiPR", sensor)
    scan = sequence.raw(0)
    data = file.read_bytes()
    rows = [struct.unpack_from("<3f", data, at) for at in range(0, len(data), width)]
    np.testing.assert_array_equal(scan.points, [row for row in rows if row != (0, 0, 0)])
    x, y, z = scan.points.astype(np.float64).T
    assert np.abs(np.degrees(np.arctan2(y, x))).max() < azimuth_deg
    assert np.abs(np.degrees(np.arctan2(z, np.hypot(x, y)))).max() < elevation_deg
    assert (np.diff(scan.times) >= 0).all()
    assert 0 <= scan.times[0] < 0.01
    assert 0.09 < scan.times[-1] < 0.1


def elevations(scan: Scan, metadata: dict[str, object]) -> Float64:
    """Of points from where their beams start, degrees, by Ouster's formula solved for them."""
    x, y, z = scan.points.astype(np.float64).T
    height = np.reshape(metadata["lidar_to_sensor_transform"], (4, 4))[2, 3] * 1e-3
    start = np.asarray(metadata["lidar_origin_to_beam_origin_mm"], np.float64) * 1e-3
    return np.degrees(np.arctan2(z - height, np.hypot(x, y) - start))


@pytest.mark.parametrize(
    ("name", "turn_s"),
    [("OS-0-128-U1_v2.3.0_1024x10", 0.1), ("OS-2-32-U0_v2.0.0_1024x10", 0.05)],  # the second is x20
)
def test_captures_of_an_ouster(name: str, turn_s: float) -> None:
    """Every beam of the metadata is met, and no other; one whole turn."""
    sequence = open_sequence(real("formats_more", "ouster", f"{name}.pcap"))
    assert (sequence.format, len(sequence), sequence.notes) == ("Ouster packets", 1, ())
    scan = sequence.raw(0)
    metadata = json.loads(real("formats_more", "ouster", f"{name}.json").read_text())
    beams = np.array(metadata["beam_altitude_angles"])
    far = np.linalg.norm(scan.points, axis=1) > 0.5
    off = np.abs(elevations(scan, metadata)[far][:, None] - beams)
    assert off.min(axis=1).max() < 0.05
    assert set(off.argmin(axis=1)) == set(range(len(beams)))
    assert 0 <= scan.times.min() < 0.01 * turn_s
    assert 0.99 * turn_s < scan.times.max() < turn_s


def test_a_bag_of_ouster_packets() -> None:
    pytest.importorskip("rosbags")
    sequence = open_sequence(real("formats_more", "ouster", "512x10_raw.bag"))
    assert (sequence.format, sequence.frame, len(sequence)) == ("ROS 1 bag", "os_sensor", 1)
    scan = sequence.raw(0)
    plausible(scan, sequence.name)
    assert len(np.unique(scan.times)) <= 512
    assert 0.099 < scan.times.max() < 0.1


def test_velodyne_packets_of_a_bag_without_definitions() -> None:
    """Against the cloud of the last message as another driver decodes it."""
    pytest.importorskip("rosbags")
    pytest.importorskip("velodyne_decoder")
    folder = real("formats_more", "nebula_vlp16")
    (file,) = folder.glob("*.pcd")
    (bag,) = (path for path in folder.iterdir() if path.is_dir())
    sequence = open_sequence(bag)
    assert (len(sequence), sequence.frame) == (4, "velodyne")
    np.testing.assert_allclose(sequence.stamps[3] + 0.1, int(file.stem) * 1e-9, atol=1e-3)
    ours, theirs = sequence.raw(3), read_scan(file)
    assert abs(len(ours) - len(theirs)) < 20
    for a, b in ((ours, theirs), (theirs, ours)):
        distance, _ = cKDTree(a.points).query(b.points)
        assert np.median(distance) < 0.01  # they differ in where a block's second firing is
        assert distance.max() < 0.1
    assert 0.098 < np.ptp(ours.times) < 0.101
