"""Numbers beside scans: names of files, stamps of poses, times of points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples.datasets import START, Drive, bag_writer, numbered
from samples.io import pcd

from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.clocks import StreamTimes, time_unit
from segloc.types import Float64, Scan

COUNT = 6
STEPS = 0.2 * np.arange(COUNT)
LINE = "{} {} 0 0 0 0 0 1\n"


NAMES = {
    "SEC.mmm": [f"{1_700_000_000 + s:.3f}" for s in STEPS],
    "prefix SEC.NSEC": [f"cloud_{1_700_000_000 + int(s)}.{round(s % 1 * 1e9):09}" for s in STEPS],
    "SEC_NSEC": [f"{1_700_000_000 + int(s)}_{round(s % 1 * 1e9):09}" for s in STEPS],
    "SEC_NSEC unpadded": [f"{1_700_000_000 + int(s)}_{round(s % 1 * 1e9)}" for s in STEPS],
    "Python's": [f"{1_700_000_000 + s:.1f}" for s in STEPS],
    "nanoseconds": [f"{1_700_000_000_000_000_000 + round(s * 1e9)}" for s in STEPS],
    "microseconds": [f"{1_700_000_000_000_000 + round(s * 1e6)}" for s in STEPS],
    "milliseconds": [f"{1_700_000_000_000 + round(s * 1e3)}" for s in STEPS],
    "milliseconds.": [f"{1_700_000_000_000 + round(s * 1e3)}.000" for s in STEPS],
    "from the start": [f"{12 + s:.6f}" for s in STEPS],
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("unit", [1.0, 1e9])
def test_files_named_by_stamps_take_poses_by_time(name: str, unit: float, tmp_path: Path) -> None:
    begin = 12.0 if name == "from the start" else 1_700_000_000.0
    scans = numbered(tmp_path / "run", [f"{stem}.npy" for stem in NAMES[name]])
    rows = [(begin + t, 10 * t) for t in np.arange(-0.025, 1.1, 0.05)]
    texts = [f"{round(t * 1e9)}" if unit == 1e9 else f"{t:.9f}" for t, _ in rows]
    poses = tmp_path / "poses.tum"
    poses.write_text(
        "".join(LINE.format(text, x) for text, (_, x) in zip(texts, rows, strict=True))
    )
    sequence = open_sequence(scans, poses)
    np.testing.assert_allclose(sequence.stamps, begin + STEPS, atol=1e-6)
    np.testing.assert_allclose(sequence.poses[:, 0, 3], 10 * STEPS, atol=1e-4)
    assert [len(sequence.scan(k)) for k in range(COUNT)] == list(range(1, COUNT + 1))


@pytest.mark.parametrize(
    ("stems", "indices"),
    [
        (["run_1.2", "run_1.3"], [2, 3]),
        (["0001", "0002"], [1, 2]),
        (["lidar2_7", "lidar2_10"], [7, 10]),
        (["20240101_0001", "20240101_0002"], [1, 2]),
        (["1_000100", "1_000200"], [100, 200]),
        (["12-00-59", "12-01-00"], [0, 1]),
        (["000007_vlp16", "000010_vlp16"], [7, 10]),
        (["20230101120000.123", "20230101120001.023"], [0, 1]),
    ],
)
def test_numbers_that_are_no_times_stay_numbers(
    stems: list[str], indices: list[int], tmp_path: Path
) -> None:
    sequence = open_sequence(numbered(tmp_path / "run", [f"{stem}.npy" for stem in stems]))
    assert sequence.indices.tolist() == indices
    assert sequence.stamps is None


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6, 1e9])
def test_poses_by_time_beside_scans_without_times(scale: float, tmp_path: Path) -> None:
    """As many as there are scans are theirs in this order; others are ignored with a note."""
    scans = numbered(tmp_path / "run", [f"{k:04}.npy" for k in range(COUNT)])
    poses = tmp_path / "odometry.tum"
    stamps = [float(scale * (1_700_000_000 + t)) for t in STEPS]
    poses.write_text("".join(LINE.format(repr(t), k) for k, t in enumerate(stamps)))
    sequence = open_sequence(scans, poses)
    np.testing.assert_allclose(np.diff(sequence.stamps), 0.2, atol=1e-3)
    assert sequence.poses[:, 0, 3].tolist() == list(range(COUNT))
    for times in (stamps[1:], [0.05 * k for k in range(4 * COUNT)]):  # 0, 1 s are no scans 0, 1
        poses.write_text("".join(LINE.format(repr(t), k) for k, t in enumerate(times)))
        with pytest.raises(DatasetError, match=r"poses are stamped, .* scans have no stamps"):
            open_sequence(scans, poses)


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("whole", [True, False])
def test_poses_by_time_since_the_start_beside_numbered_scans(
    scale: float, whole: bool, tmp_path: Path
) -> None:
    """The spacing and the speed tell the unit, and that whole times are no numbers of scans."""
    scans = numbered(tmp_path / "run", [f"{k:04}.npy" for k in range(COUNT)])
    stamps = [5.0 + 3.0 * k if scale == 1.0 and whole else scale * 0.2 * k for k in range(COUNT)]
    stamps = [round(t) if whole else t + 0.05 * scale for t in stamps]
    poses = tmp_path / "odometry.tum"
    poses.write_text("".join(LINE.format(repr(t), k) for k, t in enumerate(stamps)))
    sequence = open_sequence(scans, poses)
    assert sequence.poses[:, 0, 3].tolist() == list(range(COUNT))
    step = 3.0 if scale == 1.0 and whole else 0.2
    np.testing.assert_allclose(np.diff(sequence.stamps), step, atol=1e-3)


@pytest.mark.parametrize("decimals", [3, 6, 9])
def test_key_frames_take_the_poses_of_their_own_times(decimals: int, tmp_path: Path) -> None:
    """They are farther apart than poses are interpolated over, and files round."""
    times = [1_700_000_000_123_500_600 + 2_000_001_237 * k for k in range(20)]
    scans = numbered(tmp_path / "run", [f"{t}.npy" for t in times])
    poses = tmp_path / "poses.tum"
    texts = [f"{t // 10**9}.{t % 10**9:09}"[: 11 + decimals] for t in times]
    poses.write_text("".join(LINE.format(text, k) for k, text in enumerate(texts)))
    assert open_sequence(scans, poses).poses[:, 0, 3].tolist() == list(range(20))


TABLE = "{} {} 0 0 0.8660254 0 0 0.5\n"


@pytest.mark.parametrize(
    "head",
    [
        "header_stamp_ns x y z qw qx qy qz",
        "nsec x y z qw qx qy qz",
        "# run 3\n# made by hand\n# gps_time_ns x y z qw qx qy qz",
        "# run 3\nunix_timestamp_ns x y z qw qx qy qz",
    ],
)
def test_times_and_rotations_follow_the_names_of_columns(head: str, tmp_path: Path) -> None:
    times = [1_700_000_000 * 10**9 + 2 * 10**8 * k for k in range(COUNT)]
    scans, table = numbered(tmp_path / "run", [f"{t}.npy" for t in times]), tmp_path / "poses.txt"
    rows = [TABLE.format(times[0] + 10**7 * k, 0.05 * k) for k in range(200)]
    table.write_text(f"{head}\n{''.join(rows)}")
    sequence = open_sequence(scans, table)
    np.testing.assert_allclose(sequence.poses[:, 0, 3], np.arange(COUNT), atol=1e-4)
    np.testing.assert_allclose(sequence.poses[:, 1, 0], np.sin(np.pi / 3), atol=1e-6)


def test_poses_are_known_by_the_numbers_of_frames(tmp_path: Path) -> None:
    scans, table = numbered(tmp_path / "run", [f"{k}.npy" for k in range(9)]), tmp_path / "p.txt"
    head = "# frame x y z qw qx qy qz\n"
    table.write_text(head + "".join(TABLE.format(k, k) for k in (0, 4, 8)))
    assert open_sequence(scans, table).indices.tolist() == [0, 4, 8]
    table.write_text(head + "".join(TABLE.format(k, k) for k in range(100)))
    assert open_sequence(scans, table).poses[:, 0, 3].tolist() == list(range(9))
    for other in (range(1, 10), [7] * 9):  # counted from 1, or the number of a robot
        rows = "".join(TABLE.format(number, k) for k, number in enumerate(other))
        table.write_text(head + rows)
        assert open_sequence(scans, table).poses[:, 0, 3].tolist() == list(range(9))
    edges = "".join(f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1\n" for k in range(4, 8))
    (tmp_path / "graph.g2o").write_text(edges)
    found = open_sequence(scans, tmp_path / "graph.g2o")
    assert found.indices.tolist() == found.poses[:, 0, 3].tolist() == [4, 5, 6, 7]


def test_rows_count_from_scan_zero_and_it_is_said(tmp_path: Path) -> None:
    scans = numbered(tmp_path / "run", [f"{k}.npy" for k in range(1, 10)])
    np.savetxt(tmp_path / "poses.txt", np.tile(np.eye(4)[:3].ravel(), (10, 1)))
    sequence = open_sequence(scans, tmp_path / "poses.txt")
    assert any("scan 1 has row 2" in note for note in sequence.notes)


@pytest.mark.parametrize("scale", [1e3, 1e9])
def test_a_coincidence_makes_no_numbers_of_times(scale: float, tmp_path: Path) -> None:
    sequence = tmp_path / "00"
    numbered(sequence / "velodyne", [f"{k:06}.bin" for k in range(300)])
    (sequence / "times.txt").write_text("".join(f"{0.1 * k}\n" for k in range(300)))
    poses = tmp_path / "poses.tum"
    rows = [LINE.format(round(scale * 0.1 * k), k) for k in range(300)]
    poses.write_text("".join(rows))
    found = open_sequence(sequence, poses)
    np.testing.assert_allclose(found.poses[:, 0, 3], np.arange(300), atol=1e-6)


def test_poses_of_every_second_are_no_numbers_of_scans(tmp_path: Path) -> None:
    """On a clock that started with the sensor, 1000 s before."""
    times = [1000.05 + 0.1 * k for k in range(50)]
    scans = numbered(tmp_path / "run", [f"{t:.6f}.npy" for t in times])
    poses = tmp_path / "poses.tum"
    poses.write_text("".join(LINE.format(1000 + k, 10 * k) for k in range(10)))
    found = open_sequence(scans, poses)
    np.testing.assert_allclose(found.poses[:, 0, 3], 10 * (np.array(times) - 1000), atol=1e-6)


def test_a_table_beside_text_scans_is_no_scan(tmp_path: Path) -> None:
    scans = tmp_path / "run"
    scans.mkdir()
    for k in range(3):
        (scans / f"{k}.csv").write_text("1,2,3\n")
    (scans / "imu.csv").write_text("time,ax,ay,az\n0,0,0,9.8\n")
    sequence = open_sequence(scans)
    assert sequence.indices.tolist() == [0, 1, 2]
    assert sequence.notes == ("imu.csv left out: no number in its name",)
    over = tmp_path / "over"
    numbered(over, [])
    numbered(over / "scans", ["1.npy", "2.npy"])
    (over / "notes.csv").write_text("battery,1\n")
    with pytest.raises(
        DatasetError, match=r"among its 1 files \(1 \.csv\); scans found in subfolders: scans"
    ):
        open_sequence(over)


@pytest.mark.parametrize(
    ("name", "hint"), [("scan.e57", "export E57"), ("run.zip", "unpack it"), ("a.doc", "supported")]
)
def test_what_cannot_be_read_is_named_with_what_can(name: str, hint: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"x")
    for path in (tmp_path, tmp_path / name):
        with pytest.raises(DatasetError, match=hint) as caught:
            open_sequence(path)
        assert ".mcap" in str(caught.value) and ".pcd" in str(caught.value)


# --- times of points ------------------------------------------------------------------------------

EPOCH = 1.7e9
TIMES: dict[str, tuple[Float64, float, float | None]] = {
    "seconds": (np.linspace(0, 0.1, 9), 0.1, 1.0),
    "before the stamp": (np.linspace(-0.1, 0, 9), 0.1, 1.0),
    "a quarter of a turn": (np.linspace(0, 0.025, 9), 0.1, 1.0),
    "key frames": (np.linspace(0, 0.1, 9), 3.0, 1.0),
    "a push-broom": (np.linspace(0, 0.02, 9), 0.025, 1.0),
    "none": (np.zeros(9), 0.1, 1.0),
    "microseconds as nanoseconds": (np.linspace(0, 1e-4, 9), 0.1, 1e3),
    "milliseconds": (np.linspace(0, 100, 9), 0.1, 1e-3),
    "nanoseconds": (np.linspace(0, 1e8, 9), 0.1, 1e-9),
    "fractions": (np.linspace(0, 1, 9), 0.1, 0.1),
    "fractions of key frames": (np.linspace(0, 1, 9), 2.0, None),
    "seconds at 1 Hz": (np.linspace(0, 0.99, 9), 1.0, 1.0),
    "epoch": (EPOCH + np.linspace(0, 0.1, 9), 0.1, 1.0),
    "epoch in milliseconds": (1e3 * (EPOCH + np.linspace(0, 0.1, 9)), 0.1, 1e-3),
    "epoch in float32": ((EPOCH + np.linspace(0, 0.1, 9)).astype(np.float32) * 1.0, 0.1, None),
    "epoch, half of it": (EPOCH + np.zeros(9), 0.1, None),
    "epoch of another day": (EPOCH + 86400 + np.linspace(0, 0.1, 9), 0.1, None),
    "another clock": (5000 + np.linspace(0, 0.1, 9), 0.1, None),
    "far too long": (np.linspace(0, 7, 9), 0.1, None),
}


@pytest.mark.parametrize("name", TIMES)
def test_the_unit_of_point_times(name: str) -> None:
    times, period_s, factor = TIMES[name]
    stamp = EPOCH + (0.25 if "half" in name else 0.0)
    unit = time_unit([(times.astype(np.float64), stamp)] * 3, period_s)
    assert (unit.factor if unit.known else None) == factor
    assert bool(unit.note) == (factor != 1.0)
    assert unit.since_1970 == (unit.known and "epoch" in name)


FIELDS = {
    "t": 1e-9, "offset_time": 1e-9, "time_offset_ns": 1e-9, "timeOffsetNs": 1e-9,
    "point_time_offset": 1e-9, "time_us": 1e-6, "t_ms": 1e-3, "scalar_Time": 1e-9,
}  # fmt: skip
"""Units [s] of integers; a unit in the name holds for fractional types, too."""


@pytest.mark.parametrize("name", FIELDS)
def test_bags_and_files_know_the_same_time_fields(name: str, tmp_path: Path) -> None:
    drive, writer = Drive.make(COUNT), bag_writer("sqlite3")
    (tmp_path / "scans").mkdir()
    for i, stamp in enumerate(drive.stamps):
        points = drive.seen(i)
        ticks = np.rint(np.linspace(0.0, 0.1, len(points)) / FIELDS[name]).astype(np.uint32)
        writer.cloud("/points", stamp, points, times=(name, "u4", ticks))
        columns = [*points.T.astype("<f4"), ticks]
        rows = np.rec.fromarrays(columns, names=["x", "y", "z", name])
        file = tmp_path / "scans" / f"{stamp + 1.7e9:.3f}.pcd"
        file.write_bytes(pcd(rows, "binary"))
    for path in (writer.write(tmp_path / "drive"), tmp_path / "scans"):
        recording = open_sequence(path)
        times = recording.raw(1).times
        assert times is not None
        np.testing.assert_allclose(times, np.linspace(0, 0.1, len(times)), atol=1e-3)
        assert not recording.notes


def test_a_field_that_looks_like_times_is_named(tmp_path: Path) -> None:
    drive, writer = Drive.make(COUNT), bag_writer("sqlite3")
    for i, stamp in enumerate(drive.stamps):
        points = drive.seen(i)
        writer.cloud("/points", stamp, points, times=("firing_time", "f4", points[:, 0]))
        rows = "".join(f"{x} {y} {z} 0\n" for x, y, z in points)
        (tmp_path / f"{stamp + 1.7e9:.3f}.txt").write_text(f"x y z firing_time\n{rows}")
    for path in (writer.write(tmp_path / "drive"), tmp_path):
        (note,) = open_sequence(path).notes
        assert "'firing_time' may hold point times" in note


STREAMS: dict[str, tuple[float, float, str]] = {
    "seconds": (1.0, 0.0, ""),
    "nanoseconds since 1970": (1e9, 1e9, ""),
    "microseconds": (1e6, 0.0, "multiplied by 1e-06"),
    "fractions": (10.0, 0.0, "fractions of a turn of 0.1 s"),
    "another clock": (1.0, 1e-5, "another clock"),
}
"""Ticks a second, ticks a second of the stamp, and the note."""


@pytest.mark.parametrize("name", STREAMS)
def test_times_of_a_stream_follow_the_rule_of_recordings(name: str) -> None:
    scale, since, note = STREAMS[name]
    stream, turn = StreamTimes(), np.linspace(0.0, 0.1, 50)
    for k in range(6):
        stamp = EPOCH + 0.1 * k
        times = scale * turn + since * stamp
        # Fields of messages are converted by their type first.
        times = times * 1e-9 if since == 1e9 else times
        scan = stream.apply(Scan(np.ones((50, 3)) + turn[:, None], times=times), stamp)
        if name == "another clock" or (k < 2 and note):
            assert scan.times is None
        else:
            assert scan.times is not None
            np.testing.assert_allclose(scan.times, turn, atol=1e-5)
    assert note in stream.note and bool(note) == bool(stream.note)


def test_times_that_wrap_round_are_not_used() -> None:
    """Nanoseconds since 1970 in 32 bits look like seconds after the stamp, at times."""
    stream, turn = StreamTimes(), np.linspace(0.0, 0.1, 50)
    kept = 0
    for k in range(50):
        stamp = 1.7e9 + 0.1 * k
        times = np.mod(stamp + turn, 4.294967296)
        scan = stream.apply(Scan(np.ones((50, 3)) + turn[:, None], times=times), stamp)
        kept += scan.times is not None
    assert kept <= 20 and "point times" in stream.note


# --- bags -----------------------------------------------------------------------------------------


def test_bad_poses_of_a_bag_are_left_out_and_counted(tmp_path: Path) -> None:
    drive, T = Drive.make(COUNT), np.eye(4)
    writer = bag_writer("sqlite3")
    for i, stamp in enumerate(drive.stamps):
        writer.cloud("/points", stamp, drive.seen(i))
        writer.odometry("/odom", stamp, drive.poses[i], "base")
        writer.odometry("/gps/odom", stamp + 0.01, drive.poses[i], "gps")
        writer.odometry("/gps/odom", stamp + 0.02, drive.poses[i], "gps")
        writer.tf("/tf", stamp, drive.poses[i], "map", "odom")
    writer.tf("/tf_static", START, T, "base", "lidar")
    writer.tf("/tf_static", START, T, "base", "camera")
    writer.tf("/tf_static", START, T, "gps", "camera")
    seen: dict[str, int] = {}
    for _, topic, _, message in writer.messages:
        seen[topic] = seen.get(topic, 0) + 1
        if topic == "/gps/odom" or (topic == "/odom" and seen[topic] == 3):
            message.pose.pose.orientation.__dict__.update(x=0.0, y=0.0, z=0.0, w=0.0)
        if topic == "/tf" and seen[topic] < 3:
            message.transforms[0].transform.rotation.__dict__.update(w=float("nan"))
    path = writer.write(tmp_path / "drive")
    sequence = open_sequence(path)
    assert sequence.poses is not None and len(sequence) == COUNT
    assert np.isfinite(sequence.poses).all()
    text = "\n".join(sequence.notes)
    for line in (
        "/gps/odom: none of its 12 poses is usable",
        "/odom: 1 of 6 poses dropped",
        "/tf: 2 transforms of 'odom' dropped",
        "tf: 'camera' has two parents, 'base' and 'gps'",
    ):
        assert line in text
    assert open_sequence(path, "none").poses is None


def test_a_bag_is_read_without_poses_that_are_of_no_use(tmp_path: Path) -> None:
    drive, writer = Drive.make(COUNT), bag_writer("sqlite3")
    torn = drive.poses.copy()
    torn[3, :3, 3] = [5e6, 0.0, 0.0]
    for i, stamp in enumerate(drive.stamps):
        writer.cloud("/points", stamp, drive.seen(i))
        writer.odometry("/torn", stamp, torn[i], "lidar")
        writer.odometry("/yesterday", stamp - 86400.0, drive.poses[i], "lidar")
    sequence = open_sequence(writer.write(tmp_path / "drive"))
    assert (len(sequence), sequence.poses) == (COUNT, None)
    assert [note.partition(":")[0] for note in sequence.notes] == ["/torn", "/yesterday"]


def test_seconds_as_python_prints_them_are_in_order(tmp_path: Path) -> None:
    stems = ["12.345678", "12.445678", "12.5456", "12.9", "13.045678"]
    sequence = open_sequence(numbered(tmp_path / "run", [f"{stem}.npy" for stem in stems]))
    np.testing.assert_allclose(sequence.stamps, [float(stem) for stem in stems])
    assert [len(sequence.scan(k)) for k in range(5)] == [1, 2, 3, 4, 5]
