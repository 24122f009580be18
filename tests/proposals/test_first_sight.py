"""First sight: views all around, compared with those from places of the mapping sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from samples.plaza import Plaza
from segloc_lab.padding import beside_its_mirror, mirrored, remade

from segloc import Config, Localizer, Prior, Scan, SegmentMap, geometry
from segloc.proposals import first_sight
from segloc.proposals.first_sight import FirstSight, FirstSightConfig
from segloc.proposals.view import Bytes
from segloc.types import Candidate, Float64, Pose

AT = (-8.0, 1.0, 1.7)


def proposed(
    localizer: Localizer, scan: Scan, prior_map: SegmentMap | None = None, near: Prior | None = None
) -> list[Candidate]:
    config = localizer.config
    sections = config.first_sight, config.occupancy, config.segmentation
    sight = FirstSight(localizer.prior_map if prior_map is None else prior_map, *sections)
    return sight.propose(localizer.describe(scan), near)


def off(T: Pose, truth: Pose) -> tuple[float, float]:
    delta = geometry.inverse(truth) @ T
    return float(np.hypot(*delta[:2, 3])), math.degrees(geometry.rotation_angle(delta))


def drawn(centres: Float64, slices: Bytes) -> Bytes:
    """Return the image around the origin, by NumPy."""
    x, y = centres.T
    ring = np.floor(np.hypot(x, y) / 1.5).astype(int)
    sector = np.floor(64 * np.arctan2(y, x) / (2 * np.pi)).astype(int) % 64
    image = np.zeros((20, 4, 64), np.uint8)
    for band in range(4):
        chosen = (slices >> 2 * band & 3 > 0) & (ring < 20)
        image[ring[chosen], band, sector[chosen]] = 1
    return image


@pytest.mark.parametrize("count", [0, 1, 3000])
def test_images_are_those_of_numpy(count: int) -> None:
    rng = np.random.default_rng(count)
    centres = rng.normal(0, 18, (count, 2)).astype(np.float32)
    slices = rng.integers(0, 256, (2, count)).astype(np.uint8).min(axis=0)
    places = np.array([(0, 0), (12, -5), (0, 400)], np.float32)
    images = first_sight.polar_images(centres, slices, places, 2)
    expected = [drawn(centres.astype(np.float64) - place, slices) for place in places]
    np.testing.assert_array_equal(images, expected)
    assert images[:2].any() == (count > 0) and not images[2].any()


@pytest.mark.parametrize("yaw", [0.3, 2.5, -1.8])
def test_a_view_is_turned_to_that_of_its_place(
    plaza: Plaza, localizer: Localizer, yaw: float
) -> None:
    truth = geometry.yaw_transform(yaw, AT)
    (one,), (again,) = (proposed(localizer, plaza.scan(truth, seed=k)) for k in (7, 7))
    metres, degrees = off(one.T_map_local, truth)
    assert metres < 2.0 and degrees < 8.0 and abs(one.T_map_local[2, 3] - AT[2]) < 0.5
    assert one.fit is not None and one.fit > localizer.config.first_sight.fit
    np.testing.assert_array_equal(one.T_map_local, again.T_map_local)


def test_the_answer_is_that_of_the_segments(plaza: Plaza, localizer: Localizer) -> None:
    scan = plaza.scan(geometry.yaw_transform(2.5, AT), seed=7)
    seen = localizer.localize(scan)
    by_segments = localizer.config.model_copy(
        update={"first_sight": FirstSightConfig(enabled=False)}
    )
    matched = Localizer(localizer.prior_map, by_segments).localize(scan)
    assert seen.T_map_sensor is not None and matched.T_map_sensor is not None
    assert (seen.proposer, matched.proposer) == ("first sight", "segments")
    assert max(off(seen.T_map_sensor, matched.T_map_sensor)) < 0.05
    assert seen.confidence > 0.999 and matched.confidence > 0.999
    assert seen.counts["matches"] == seen.inliers == 0 < matched.inliers


def test_places_that_look_alike_are_left_to_the_segments(
    plaza: Plaza, localizer: Localizer
) -> None:
    scan = plaza.scan(geometry.yaw_transform(0.3, AT), seed=7)
    assert proposed(localizer, scan)
    assert not proposed(localizer, scan, beside_its_mirror(localizer.prior_map))
    assert not proposed(localizer, scan, mirrored(localizer.prior_map))
    assert not proposed(localizer, Plaza(1).scan(geometry.yaw_transform(0.3, AT)))


def test_a_view_that_is_not_all_around_is_left_to_the_segments(
    plaza: Plaza, localizer: Localizer
) -> None:
    scan = plaza.scan(geometry.yaw_transform(0.3, AT), seed=7)
    ahead = np.abs(np.arctan2(scan.points[:, 1], scan.points[:, 0])) < math.radians(120.0)
    narrow = Scan(scan.points[ahead], T_odom_sensor=scan.T_odom_sensor)
    assert not proposed(localizer, narrow)
    assert localizer.localize(narrow).proposer == "segments"


def test_a_prior_and_maps_without_ground_or_path_are_respected(
    plaza: Plaza, localizer: Localizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, prior_map = plaza.scan(geometry.yaw_transform(0.3, AT), seed=7), localizer.prior_map
    assert proposed(localizer, scan, near=Prior(AT[:2], 10.0))
    assert not proposed(localizer, scan, near=Prior((40.0, 0.0), 10.0))
    bare = remade(prior_map)
    bare.metadata["ground"] = "none"
    assert not bare.has_ground and not proposed(localizer, scan, bare)
    assert not proposed(localizer, scan, SegmentMap.empty("geo", "f", 7, (0.0, 0.0, 0.0)))
    monkeypatch.setattr(first_sight, "_MOST_PLACES", 3)  # of a very large map
    assert not proposed(localizer, scan)
    clouds = Config().occupancy.model_copy(update={"enabled": False})
    assert (
        Localizer(prior_map, localizer.config.model_copy(update={"occupancy": clouds})).first_sight
        is None
    )
