"""Values that no map may hold, under checksums that are right: refused with file, field and row."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.maps import make_map
from samples.walk import run

from segloc.descriptors.weightfile import read_weights, write_weights
from segloc.errors import MapFormatError, SeglocError, WeightsError
from segloc.map import file as mapfile
from segloc.map.segment_map import SegmentMap
from segloc.system.tensor_file import TensorFile

NAN, INF = float("nan"), float("inf")
CHANGES: dict[str, tuple[tuple[int, ...], float]] = {
    f"{name}-{value:g}": (index, value)
    for name, index, values in [
        ("origin", (1,), (NAN, -INF, 1e9)),
        ("centroids", (4, 2), (NAN, INF, 1e12)),
        ("stamps", (5,), (NAN, INF)),
        ("trajectory", (1, 0, 3), (NAN, INF, 1e12)),
        ("trajectory", (1, 0, 0), (0.5, -1)),
        ("trajectory", (1, 3, 3), (2,)),
        ("vectors", (2, 1), (NAN, INF, 1e30)),
        ("quality", (3,), (NAN, -0.01, 1.01)),
        ("cloud", (7, 1), (NAN, INF, 5e6)),
        ("sizes", (1,), (-1,)),
        ("missed", (2,), (-1,)),
    ]
    for value in values
}


def contents(**changes: Any) -> mapfile.Contents:
    prior_map = make_map()
    parts = ("cloud", "origin", "trajectory")
    arrays = prior_map.columns() | {name: getattr(prior_map, name) for name in parts}
    arrays = {name: array.copy() for name, array in arrays.items()}
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
    assert run("map", "merge", path, other, "--out", path.with_name("merged.segmap")) == 1
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


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
@pytest.mark.parametrize("kind", ["map", "weights"])
def test_files_that_shrink_while_they_are_read(
    kind: str, share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, plain = tmp_path / "file", TensorFile.read
    if kind == "map":
        make_map().save(path)
    else:
        write_weights(path, "network", {"w": np.ones((20, 10), np.float32)}, {}, {})

    def read(self: TensorFile, *given: Any) -> Any:
        os.truncate(path, int(share * path.stat().st_size))
        return plain(self, *given)

    monkeypatch.setattr(TensorFile, "read", read)
    with pytest.raises((MapFormatError, WeightsError), match=f"^{re.escape(str(path))}"):
        SegmentMap.load(path) if kind == "map" else read_weights(path, "network")
