"""Folders of scans: order, numbers, poses, selections."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samples.datasets import numbered

from segloc.errors import ConfigError, DatasetError
from segloc.tools.datasets import Sequence, open_sequence, parse_select
from segloc.tools.io import Trajectory, write_kitti, write_scan, write_tum


def straight(stamps: list[float]) -> Trajectory:
    """A path with x = 10 times the stamp."""
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 0, 3] = np.array(stamps) * 10
    return Trajectory(np.array(stamps, dtype=float), poses)


def test_scans_in_order_with_numbers_stamps_and_poses(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "run", ["lidar2_7.pcd", "lidar2_8.npy", "lidar2_10.bin"])
    (folder / ".lidar2_9.bin.tmp").write_bytes(b"unfinished")
    (folder / ".lidar2_9.bin").write_bytes(b"hidden")
    (folder / "times.txt").write_text("0.1\n0.2\n")
    (folder / "photo.png").write_bytes(b"")
    write_tum(tmp_path / "poses.tum", straight([7, 8, 9, 10]))
    sequence: Sequence = open_sequence(folder, tmp_path / "poses.tum")
    assert (sequence.name, len(sequence)) == ("run", 3)
    assert sequence.indices.dtype == np.int64
    assert sequence.indices.tolist() == [7, 8, 10]
    assert sequence.poses.dtype == np.float64
    assert sequence.poses[:, 0, 3].tolist() == [70, 80, 100]
    for position, index in enumerate((7, 8, 10)):
        scan = sequence.scan(position)
        assert len(scan) == position + 1
        assert scan.stamp is None  # its poses are keyed by numbers: it has no times
        assert scan.T_odom_sensor[0, 3] == 10 * index
    for position in (-1, 3):
        with pytest.raises(DatasetError, match=f"no scan at position {position}"):
            sequence.scan(position)
    again = pickle.loads(pickle.dumps(sequence))  # sequences are handed to worker processes
    assert len(again.scan(2)) == 3


def test_without_poses_and_without_numbers(tmp_path: Path) -> None:
    sequence = open_sequence(numbered(tmp_path / "run", ["a.ply", "b.ply"]))
    assert sequence.indices.tolist() == [0, 1]
    assert sequence.poses is None
    assert sequence.scan(1).T_odom_sensor is None


def test_the_file_of_one_scan_is_a_recording_of_it(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "run", ["7.ply", "8.ply"])
    one = open_sequence(folder / "8.ply")
    assert (one.name, one.indices.tolist()) == ("8.ply", [8])
    np.testing.assert_array_equal(one.scan(0).points, open_sequence(folder).scan(1).points)


def test_text_files_are_scans_only_among_themselves(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "run", ["1.csv", "2.csv"])
    write_kitti(folder / "poses.txt", straight([0, 1, 2]))
    assert len(open_sequence(folder, folder / "poses.txt")) == 2
    write_scan(folder / "3.laz", np.ones((1, 3)))
    mixed = open_sequence(folder)
    assert mixed.indices.tolist() == [3]
    assert "3 .csv and .txt files left out: scans are those in .laz" in mixed.notes


def test_a_map_beside_numbered_scans_is_no_scan(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "run", ["1.ply", "2.ply", "map.ply"])
    found = open_sequence(folder)
    assert found.indices.tolist() == [1, 2]
    assert "map.ply left out: no number in its name" in found.notes


def test_a_kitti_file_is_keyed_by_row_if_it_reaches_else_by_position(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "run", ["2.npy", "4.npy", "5.npy"])
    for rows, expected in (
        (6, [20, 40, 50]),
        (9, [20, 40, 50]),
        (5, [0, 10, 20]),
        (3, [0, 10, 20]),
    ):
        write_kitti(tmp_path / "poses.txt", straight(list(range(rows))))
        sequence = open_sequence(folder, tmp_path / "poses.txt")
        assert sequence.poses[:, 0, 3].tolist() == expected
        part = sequence.select(parse_select("4:"))
        assert part.poses[:, 0, 3].tolist() == expected[1:]
    write_kitti(tmp_path / "poses.txt", straight([0, 1]))
    first = open_sequence(folder, tmp_path / "poses.txt")
    assert first.indices.tolist() == [2, 4]
    assert [note.split(": ")[-1] for note in first.notes] == [
        "2 rows, used as the poses of the first 2 scans",
        f"no pose in {tmp_path / 'poses.txt'}; using the other 2 (--select A:B,C:D selects fewer)",
    ]


def test_scans_without_a_pose_are_left_out_and_counted(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "run", [f"{i:04}.npy" for i in range(8)])
    write_tum(tmp_path / "poses.tum", straight([2, 3, 4]))
    whole = open_sequence(folder, tmp_path / "poses.tum")
    assert whole.indices.tolist() == [2, 3, 4]
    left_out = f"5 of 8 scans dropped: no pose in {tmp_path / 'poses.tum'}"
    assert whole.notes == (f"{left_out}; using the other 3 (--select A:B,C:D selects fewer)",)
    part = open_sequence(folder, tmp_path / "poses.tum", "2:4")
    assert part.indices.tolist() == [2, 3, 4]
    assert part.notes == ()
    assert part.select(parse_select("4,3")).indices.tolist() == [3, 4]
    with pytest.raises(DatasetError, match="no pose in"):
        open_sequence(folder, tmp_path / "poses.tum", "6:7")
    with pytest.raises(DatasetError, match="run: 8:20 selects none of the scans 0 to 7"):
        open_sequence(folder, select="8:20")


def test_poses_are_looked_for_beside_the_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = numbered(tmp_path / "run", ["0.npy", "1.npy"])
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    places = [tmp_path, folder, tmp_path / "elsewhere"]  # the later, the sooner it is found
    for shift, place in enumerate(places, start=1):
        poses = straight([0, 1]).poses.copy()
        poses[:, 1, 3] = shift
        write_tum(place / "poses.tum", Trajectory(np.array([0.0, 1.0]), poses))
        sequence = open_sequence("../run", "poses.tum")
        assert sequence.poses[0, 1, 3] == shift
    with pytest.raises(DatasetError, match=r"other\.tum: no such file"):
        open_sequence(folder, "other.tum")


def test_folders_that_are_no_recordings(tmp_path: Path) -> None:
    empty = numbered(tmp_path / "empty", [])
    with pytest.raises(DatasetError, match="no such folder"):
        open_sequence(tmp_path / "missing")
    with pytest.raises(DatasetError, match="no scans of a known format"):
        open_sequence(empty)
    (empty / "photo.png").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"photo\.png: not a recording of a known format"):
        open_sequence(empty / "photo.png")
    with pytest.raises(DatasetError, match="no scans of a known format among its 1 files"):
        open_sequence(empty)
    over = tmp_path / "over"
    over.mkdir()
    numbered(over / "more", ["0.npy"])
    with pytest.raises(DatasetError, match="among its 0 files; scans found in subfolders: more"):
        open_sequence(over)
    twice = numbered(tmp_path / "twice", ["a_01.npy", "b_1.npy"])
    with pytest.raises(DatasetError, match=r"a_01\.npy and b_1\.npy are both scan 1"):
        open_sequence(twice)
    large = numbered(tmp_path / "large", ["9" * 30 + ".npy"])
    with pytest.raises(DatasetError, match="too large"):
        open_sequence(large)
    broken = numbered(tmp_path / "broken", ["0.npy"])
    (broken / "0.npy").write_bytes(b"nothing of the kind")
    with pytest.raises(DatasetError, match=re.escape(str(broken / "0.npy"))):
        open_sequence(broken).scan(0)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 60), st.integers(0, 30), st.sampled_from(["", ":", "a:", ":b", "a:b"])
        ),
        min_size=1,
        max_size=5,
    )
)
def test_a_selection_is_the_union_of_its_parts(parts: list[tuple[int, int, str]]) -> None:
    texts, wanted = [], set()
    for first, length, form in parts:
        last = first + length
        text, members = {
            "": (f"{first}", {first}),
            ":": (f"{first}:{first}", {first}),
            "a:": (f"{first}:", set(range(first, 100))),
            ":b": (f":{last}", set(range(last + 1))),
            "a:b": (f" {first}:{last} ", set(range(first, last + 1))),
        }[form]
        texts.append(text)
        wanted |= members
    selection = parse_select(",".join(texts))
    assert set(np.flatnonzero(selection.mask(np.arange(100)))) == wanted
    assert parse_select(str(selection)) == selection


@pytest.mark.parametrize(
    "text", ["", ",", ":", "1,", "a", "1:b", "5:3", "-3", "1:2:3", "1 2", "1.5", "²", "9" * 40]
)
def test_bad_selections(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^selection ") as caught:
        parse_select(text)
    assert "\n" not in str(caught.value)
