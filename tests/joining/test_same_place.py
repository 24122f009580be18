"""Maps are joined only where they are of one place in one frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.walk import run

from segloc import Config, SegmentMap, build_map, geometry
from segloc.errors import MapMismatch
from segloc.joining.same_place import Meeting, check_same_place, meeting
from segloc.map.voxel_cloud import VoxelCloud
from segloc.types import Float64, Pose

CONFIG = Config.preset("geo").model_copy(update={"threads": 1})


def plaza_map(seed: int, offset: Float64 | None = None) -> SegmentMap:
    walk = PlazaSequence(Plaza(seed), steps=10)
    if offset is not None:
        walk.poses[:, :3, 3] += offset
    return build_map(walk, CONFIG)


def moved(prior_map: SegmentMap, T: Pose) -> SegmentMap:
    """The map in another frame."""
    cloud = geometry.transform(T, prior_map.cloud + prior_map.origin)
    origin = cloud.mean(axis=0)
    segments = prior_map.columns()
    segments["centroids"] = geometry.transform(T, prior_map.centroids)
    return SegmentMap(
        prior_map.descriptor,
        prior_map.fingerprint,
        segments,
        VoxelCloud((cloud - origin).astype(np.float32), origin, prior_map.cloud_voxel),
        T @ prior_map.trajectory,
    )


@pytest.fixture(scope="module")
def one() -> SegmentMap:
    return plaza_map(0)


@pytest.fixture(scope="module")
def again() -> SegmentMap:
    return plaza_map(0, np.array([1.0, 2.0, 0.0]))


@pytest.mark.slow
def test_one_place_is_one_place_in_any_frame(one: SegmentMap, again: SegmentMap) -> None:
    for T in (np.eye(4), geometry.yaw_transform(2.0, (465_000.0, 5_251_000.0, 410.0))):
        found = meeting(moved(one, T), moved(again, T))
        assert found.agreement is not None and found.agreement > 0.75
        check_same_place(moved(one, T), moved(again, T))
    itself = meeting(one, one)
    assert itself.agreement == pytest.approx(1.0)


@pytest.mark.slow
def test_another_place_and_another_frame_are_refused(one: SegmentMap, again: SegmentMap) -> None:
    with pytest.raises(MapMismatch, match="overlap no better than chance"):
        check_same_place(one, plaza_map(1))
    for T in (geometry.yaw_transform(0.4), geometry.yaw_transform(0.0, (4.0, -3.0, 0.0))):
        with pytest.raises(MapMismatch, match="in two frames"):
            check_same_place(one, moved(again, T), elsewhere=True)
    far = moved(again, geometry.yaw_transform(0.0, (500.0, 0.0, 0.0)))
    with pytest.raises(MapMismatch, match="do not meet"):
        check_same_place(one, far)
    check_same_place(one, far, elsewhere=True)
    storey = moved(again, geometry.yaw_transform(0.0, (0.0, 0.0, 3.0)))
    with pytest.raises(MapMismatch, match="do not meet"):  # a storey above is another place
        check_same_place(one, storey)


def test_what_cannot_be_judged_passes(one: SegmentMap) -> None:
    nothing = SegmentMap.empty("geo", one.fingerprint, one.dim)
    check_same_place(one, nothing)
    check_same_place(nothing, nothing)
    few = one.kept(np.ones(len(one), bool), np.arange(len(one.cloud)) < 50)
    assert meeting(one, few).agreement is None
    check_same_place(one, few)
    assert meeting(one, nothing) == Meeting(0, 0, None)


@pytest.mark.slow
def test_maps_of_a_row_need_no_order(tmp_path: Path) -> None:
    row = {
        name: plaza_map(0, np.array([x, 0.0, 0.0])) for name, x in (("a", -16), ("b", 16), ("c", 0))
    }
    files = [tmp_path / f"{name}.segmap" for name in row]
    for file, prior_map in zip(files, row.values(), strict=True):
        prior_map.save(file)
    assert not meeting(row["a"], row["b"]).places
    assert run("map", "merge", *files, "--out", tmp_path / "out.segmap") == 0
