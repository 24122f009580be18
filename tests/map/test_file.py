"""The map file: round trips, damage of every kind, and saving that fails half-way."""

from __future__ import annotations

import errno
import io
import os
import pickle
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file
from samples.mapfiles import (
    ARRAYS,
    assert_identical,
    assert_refused,
    header_end,
    load_bytes,
    with_header,
)
from samples.maps import make_map

from segloc.errors import MapFormatError, SeglocError
from segloc.map import file as mapfile
from segloc.map.segment_map import SegmentMap


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[SegmentMap, bytes]:
    prior_map, path = make_map(), tmp_path_factory.mktemp("map") / "a.segmap"
    prior_map.save(path)
    return prior_map, path.read_bytes()


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    views=st.integers(0, 3),
    segments=st.integers(0, 4),
    quality=st.booleans(),
    metadata=st.dictionaries(st.text(max_size=5), st.text(max_size=20), max_size=3),
)
def test_round_trip(
    tmp_path: Path, views: int, segments: int, quality: bool, metadata: dict[str, str]
) -> None:
    prior_map = make_map(views, segments=segments, quality=quality)
    prior_map.metadata = metadata
    prior_map.save(tmp_path / "a.segmap")
    loaded = SegmentMap.load(tmp_path / "a.segmap")
    assert_identical(prior_map, loaded)
    loaded.save(tmp_path / "b.segmap")
    assert (tmp_path / "a.segmap").read_bytes() == (tmp_path / "b.segmap").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.segmap", "b.segmap"]


def test_any_safetensors_reader_opens_it(tmp_path: Path) -> None:
    prior_map = make_map()
    prior_map.save(tmp_path / "a.segmap")
    arrays = load_file(tmp_path / "a.segmap")
    assert arrays.keys() == set(ARRAYS)
    for name, array in arrays.items():
        assert np.array_equal(array, getattr(prior_map, name))


def test_truncation_is_noticed(tmp_path: Path, saved: tuple[SegmentMap, bytes]) -> None:
    data = saved[1]
    end = header_end(data)
    for length in [*range(end + 1), *range(end + 1, len(data), 37), len(data) - 1]:
        assert_refused(tmp_path / "cut.segmap", data[:length])
    assert_refused(tmp_path / "long.segmap", data + b"\0")


def test_every_flipped_bit_is_noticed(tmp_path: Path, saved: tuple[SegmentMap, bytes]) -> None:
    data, path = saved[1], tmp_path / "flipped.segmap"
    end = header_end(data)
    path.write_bytes(data)
    with path.open("r+b", buffering=0) as file:
        for position in [*range(end), *range(end, len(data), 23)]:
            for bit in range(8) if position < end else [position % 8]:
                for byte in (data[position] ^ 1 << bit, data[position]):  # damaged, mended
                    file.seek(position)
                    file.write(bytes([byte]))
                    if byte != data[position]:
                        with pytest.raises(MapFormatError) as caught:
                            SegmentMap.load(path)
                        assert "\n" not in str(caught.value)
    assert path.read_bytes() == data


@pytest.mark.parametrize("shape", [[2**63], [2**31, 2**31], [2**64, 3]])
def test_absurd_sizes_allocate_nothing(
    tmp_path: Path, saved: tuple[SegmentMap, bytes], shape: list[int]
) -> None:
    def grow(header: dict[str, Any]) -> None:
        size = int(np.prod([float(n) for n in shape])) * 4
        begin = header["cloud"]["data_offsets"][0]
        header["cloud"].update(shape=shape, data_offsets=[begin, min(begin + size, 2**64 - 1)])

    for data in (with_header(saved[1], grow, sign=True), (2**63).to_bytes(8, "little") + b"{}"):
        tracemalloc.start()
        assert_refused(tmp_path / "huge.segmap", data)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1 << 20


def _set(name: str, **values: Any) -> Callable[[dict[str, Any]], None]:
    return lambda header: header[name].update(values)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda h: h.update(extra=h.pop("sizes")), "missing sizes"),
        (lambda h: h["__metadata__"].pop("descriptor"), "missing descriptor"),
        (lambda h: h["__metadata__"].pop("checksum.cloud"), "cloud does not match"),
        (lambda h: h["__metadata__"].clear(), "not a segloc map"),
        (lambda h: h.pop("__metadata__"), "not a segloc map"),
        (_set("__metadata__", segmap_version="3"), r"newer segloc \(map format 3"),
        (_set("sizes", dtype="F32"), "sizes is F32"),
        (_set("centroids", shape=[9, 2]), r"centroids is F64 \(9, 2\)"),
        (_set("vectors", shape=[5, 6]), r"vectors is F32 \(5, 6\), not F32 \(6, D\)"),
        (_set("trajectory", shape=[1, 32]), "trajectory"),
        (_set("__metadata__", cloud_voxel="-1"), "cloud_voxel"),
        (_set("__metadata__", cloud_voxel="nan"), "cloud_voxel"),
        (_set("__metadata__", cloud_voxel="wide"), "text fields"),
        (_set("__metadata__", metadata="[1]"), "text fields"),
        (_set("__metadata__", metadata="[" * 100_000), "text fields"),
    ],
)
def test_forged_headers_are_refused(
    tmp_path: Path,
    saved: tuple[SegmentMap, bytes],
    change: Callable[[dict[str, Any]], None],
    fault: str,
) -> None:
    sign = "segloc" not in fault
    assert_refused(tmp_path / "a.segmap", with_header(saved[1], change, sign=sign), fault)


def test_missing_and_strange_paths(tmp_path: Path, saved: tuple[SegmentMap, bytes]) -> None:
    for path, fault in [
        (tmp_path / "none.segmap", "no such file"),
        (tmp_path, "a folder"),
        (Path("/dev/null"), "not a regular file"),
    ]:
        with pytest.raises(MapFormatError, match=fault):
            SegmentMap.load(path)
    (tmp_path / "file").write_bytes(b"")
    assert_refused(tmp_path / "file", b"", "(?i)header ?too ?small")
    for path, fault in [
        (tmp_path / "none" / "a.segmap", "no folder"),
        (tmp_path / "file" / "a.segmap", "no folder"),
        (tmp_path, "is a directory"),
        (Path("/dev/null"), "not a regular file"),
        (tmp_path / ("a" * 250), "name too long"),
    ]:
        with pytest.raises(SeglocError, match=fault) as caught:
            saved[0].save(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)


class FullDisk(io.BufferedWriter):
    """A file on a disk that is full after some bytes."""

    room = 0

    def write(self, data: Any) -> int:
        count = memoryview(data).nbytes
        if count > FullDisk.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        FullDisk.room -= count
        return super().write(data)


@pytest.mark.parametrize("failure", [OSError(errno.EIO, "Input/output error"), KeyboardInterrupt()])
@pytest.mark.parametrize("step", ["fsync", "rename"])
def test_a_failed_save_leaves_the_old_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, failure: BaseException
) -> None:
    old = make_map(1)
    old.save(tmp_path / "a.segmap")

    def fail(*_: Any) -> None:
        raise failure

    with monkeypatch.context() as patch:
        patch.setattr(*((os, "fsync") if step == "fsync" else (Path, "replace")), fail)
        kind = SeglocError if isinstance(failure, OSError) else KeyboardInterrupt
        with pytest.raises(kind):
            make_map(2).save(tmp_path / "a.segmap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.segmap"]
    assert_identical(old, SegmentMap.load(tmp_path / "a.segmap"))


def test_a_full_disk_leaves_the_old_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = make_map(1)
    old.save(tmp_path / "a.segmap")
    size = (tmp_path / "a.segmap").stat().st_size
    for room in (0, size // 2, size - 1):
        FullDisk.room = room
        with monkeypatch.context() as patch:
            patch.setattr(Path, "open", lambda p, mode: FullDisk(io.FileIO(p, mode)))
            with pytest.raises(SeglocError, match="cannot be written: no space left"):
                make_map(1, seed=1).save(tmp_path / "a.segmap")
        assert [p.name for p in tmp_path.iterdir()] == ["a.segmap"]
        assert_identical(old, SegmentMap.load(tmp_path / "a.segmap"))


KILLED = """
import os, pathlib, sys
from segloc import SegmentMap
prior_map = SegmentMap.empty("geo", "f", 2)
setattr(*{"fsync": (os, "fsync"), "rename": (pathlib.Path, "replace")}[sys.argv[2]],
        lambda *_: os.kill(os.getpid(), 9))
prior_map.save(sys.argv[1])
"""


@pytest.mark.slow
@pytest.mark.parametrize("step", ["fsync", "rename"])
def test_a_killed_writer_leaves_the_old_map(tmp_path: Path, step: str) -> None:
    old = make_map(1)
    old.save(tmp_path / "a.segmap")
    command = [sys.executable, "-c", KILLED, str(tmp_path / "a.segmap"), step]
    assert subprocess.run(command, check=False).returncode == -9
    assert_identical(old, SegmentMap.load(tmp_path / "a.segmap"))


def test_saving_through_a_link_keeps_the_link(tmp_path: Path) -> None:
    make_map(1).save(tmp_path / "a.segmap")
    (tmp_path / "link").symlink_to("a.segmap")
    make_map(2).save(tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert_identical(make_map(2), SegmentMap.load(tmp_path / "a.segmap"))


def test_loading_never_unpickles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, saved: tuple[SegmentMap, bytes]
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("pickle was used")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    load_bytes(tmp_path / "a.segmap", saved[1])
    assert_refused(tmp_path / "b.segmap", pickle.dumps({"vectors": [1, 2]}))
    assert not any("pickle" in vars(module) for module in (mapfile, SegmentMap))
