"""Values that no map may hold, under checksums that are right: refused with file, field and row."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.maps import make_map

from segloc import cli
from segloc.errors import MapFormatError, SeglocError
from segloc.map import file as mapfile
from segloc.map.segment_map import SegmentMap
from segloc.types import Descriptors

NAN, INF = float("nan"), float("inf")
CHANGES: dict[str, tuple[tuple[int, ...], float]] = {
    f"{name}-{value:g}": (index, value)
    for name, index, values in [
        ("origin", (1,), (-INF, 1e9)),
        ("centroids", (4, 2), (INF, 1e12)),
        ("stamps", (5,), (INF,)),
        ("trajectory", (1, 0, 3), (INF, 1e12)),
        ("trajectory", (1, 0, 0), (0.5, -1)),
        ("trajectory", (1, 3, 3), (2,)),
        ("vectors", (2, 1), (INF, 1e30)),
        ("quality", (3,), (-0.01, 1.01)),
        ("cloud", (7, 1), (INF, 5e6)),
        ("sizes", (1,), (-1,)),
        ("missed", (2,), (-1,)),
    ]
    for value in values
}


def contents(**changes: Any) -> mapfile.Contents:
    prior_map = make_map()
    arrays = {name: array.copy() for name, array in prior_map._arrays().items()}
    arrays["missed"] = np.arange(6, dtype=np.int32)
    fields = {"descriptor": "geo", "fingerprint": "f" * 16, "cloud_voxel": 0.25, "metadata": {}}
    return mapfile.Contents(**{"arrays": arrays, **fields, **changes})


def write_unchecked(path: Path, forged: mapfile.Contents, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(mapfile.Contents, "fault", lambda *_: None)
        mapfile.write(path, forged)


def assert_refused(path: Path, forged: mapfile.Contents, match: str, monkeypatch: Any) -> None:
    """Neither read nor written; and `map merge` does not write it on."""
    write_unchecked(path, forged, monkeypatch)
    with pytest.raises(MapFormatError, match=f"^{re.escape(str(path))}: .*{match}") as caught:
        SegmentMap.load(path)
    assert "\n" not in str(caught.value)
    other = path.with_name("other.segmap")
    with pytest.raises(SeglocError, match=match):
        mapfile.write(other, forged)
    make_map().save(other)
    monkeypatch.setattr("sys.argv", ["segloc", "map", "merge", *map(str, (path, other)), "--out",
                                     str(path.with_name("merged.segmap"))])  # fmt: skip
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 1
    assert sorted(p.name for p in path.parent.iterdir()) == ["bad.segmap", "other.segmap"]


@pytest.mark.parametrize("change", CHANGES)
def test_values_are_refused(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    name, (index, value) = change.split("-")[0], CHANGES[change]
    forged = contents()
    forged.arrays[name][index] = value
    match = f"{name}: row {index[0]} "
    assert_refused(tmp_path / "bad.segmap", forged, match, monkeypatch)
    assert re.fullmatch(rf"segloc: error: .*{match}.*\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"cloud_voxel": 1e-12}, "cloud_voxel must be from 0.001"),
        ({"metadata": {"config": 5}}, "metadata: 'config' is not text"),
        ({"metadata": {"config": {"a": ["b"]}}}, "metadata: 'config' is not text"),
        ({"metadata": {"config": "\ud800"}}, "metadata: 'config' is not text"),
        ({"descriptor": "geo\nsegloc: all is well"}, "descriptor: not a line of text"),
        ({"fingerprint": "f" * 2000}, "fingerprint: not a line of text"),
    ],
)
def test_texts_are_refused(
    changes: dict[str, Any], match: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert_refused(tmp_path / "bad.segmap", contents(**changes), match, monkeypatch)


def test_one_nan_anywhere_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "bad.segmap"
    floats = [name for name, array in contents().arrays.items() if array.dtype.kind == "f"]
    for name in floats:
        forged = contents()
        flat = forged.arrays[name].reshape(-1)
        place = int(rng.integers(len(flat)))
        flat[place] = NAN
        write_unchecked(path, forged, monkeypatch)
        row = place // (flat.size // len(forged.arrays[name]))
        with pytest.raises(MapFormatError, match=rf"{name}: row {row} has nan: not finite"):
            SegmentMap.load(path)


def test_the_limits_themselves_are_allowed(tmp_path: Path) -> None:
    allowed = contents(cloud_voxel=1.0)
    for name, row, value in [
        ("centroids", 0, -1e8),
        ("cloud", 0, 1e6),
        ("quality", 0, 1.0),
        ("quality", 1, 0.0),
        ("sizes", 0, 2**31 - 1),
        ("session", 0, 2**31 - 1),
        ("missed", 0, 2**30),
    ]:
        allowed.arrays[name][row] = value
    mapfile.write(tmp_path / "a.segmap", allowed)
    loaded = SegmentMap.load(tmp_path / "a.segmap")
    merged = make_map(seed=3).merge(loaded)
    assert len(loaded.merge(make_map(seed=3))) == len(merged) == 12


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda m: m.add_trajectory(np.eye(4)[None] * np.diag([1, 1, -1, 1])), "not a rigid pose"),
        (lambda m: _add(m, quality=[1.5]), "quality: row 0 has 1.5: outside 0 to 1"),
        (lambda m: _add(m, sizes=[-3]), "sizes: row 0 has -3"),
        (lambda m: _add(m, centroids=[[1e12, 0, 0]]), "centroids: row 0 has 1e"),
        (lambda m: _add(m, cloud=[[1e12, 0, 0]]), "cloud: row 0 has 1e.*from its origin"),
        (lambda m: _add(m, cloud=[[1e300, 0, 0]]), "not finite"),
    ],
)
def test_a_map_is_not_filled_with_what_could_not_be_saved(
    change: Callable[[SegmentMap], None], match: str, tmp_path: Path
) -> None:
    prior_map = make_map()
    with pytest.raises(SeglocError, match=match):
        change(prior_map)
    prior_map.save(tmp_path / "a.segmap")
    assert len(SegmentMap.load(tmp_path / "a.segmap")) == 6


def _add(prior_map: SegmentMap, **changes: Any) -> None:
    given = {"centroids": [[0.0, 0, 0]], "sizes": [3], "cloud": np.zeros((0, 3)), "quality": [0.5]}
    given |= {name: np.array(value) for name, value in changes.items()}
    vectors, quality = np.zeros((1, 5), np.float32), np.array(given.pop("quality"), np.float32)
    prior_map.add(Descriptors(vectors, quality), session=0, stamp=0.0, **given)


SHRINKING = """
import os, sys, threading, time
from segloc.errors import MapFormatError, WeightsError
from segloc.descriptors.weightfile import read_weights
from segloc.map.segment_map import SegmentMap
from pathlib import Path

path, kind, trials = sys.argv[1], sys.argv[2], int(sys.argv[3])
whole = open(path, "rb").read()
refused = 0

def load():
    if kind == "map":
        assert len(SegmentMap.load(path)) == 20_000
    else:
        assert len(read_weights(Path(path), "network").tensors) == 1

for _ in range(2):  # what the first imports does not count
    began = time.monotonic()
    load()
    takes = time.monotonic() - began
for trial in range(4 * trials):  # how often it is met while it reads depends on the machine
    if trial >= trials and refused > 5:
        break
    with open(path, "wb") as file:
        file.write(whole)
    def shrink():
        time.sleep(trial % 30 * takes / 60)  # it reads in the first half
        os.truncate(path, (trial * 7919) % len(whole))
    thread = threading.Thread(target=shrink)
    thread.start()
    try:
        load()
    except (MapFormatError, WeightsError) as error:
        assert str(error).startswith(path), error
        refused += 1
    thread.join()
print(refused)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["map", "weights"])
def test_files_that_shrink_while_they_are_read(kind: str, tmp_path: Path) -> None:
    from segloc.descriptors.weightfile import write_weights

    path = tmp_path / "file"
    if kind == "map":
        rng = np.random.default_rng(0)
        prior_map = SegmentMap.empty("geo", "f", 64)
        vectors, cloud = rng.normal(size=(20_000, 64)), rng.normal(size=(200_000, 3)) * 200
        prior_map.add(Descriptors(vectors.astype(np.float32)), np.zeros((20_000, 3)),
                      np.ones(20_000, int), session=0, stamp=0.0, cloud=cloud)  # fmt: skip
        prior_map.save(path)
    else:
        write_weights(path, "network", {"w": np.ones((2000, 1000), np.float32)}, {}, {})
    command = [sys.executable, "-c", SHRINKING, str(path), kind, "40"]
    child = subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)
    assert child.returncode == 0, (child.returncode, child.stderr)
    assert 5 < int(child.stdout) <= 160
