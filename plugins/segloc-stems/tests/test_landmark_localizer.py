"""Landmarks in, a pose out: found where it is, refused where it is not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from samples import stems
from segloc_stems import LandmarkLocalizer, LandmarkMap, LandmarkMapper, Landmarks

from segloc import geometry
from segloc.errors import ConfigError, InvalidScan
from segloc.localization import Localization, Reason
from segloc.map.segment_map import SegmentMap
from segloc.types import Pose

POSES = [stems.pose(x, y, yaw) for x, y, yaw in ((20, 42, 0.3), (33, 36, 2.0), (55, 45, -2.8))]


@pytest.fixture(scope="module")
def site() -> LandmarkMap:
    return stems.surveyed(stems.stand(1))


@pytest.fixture(scope="module")
def localizer(site: LandmarkMap) -> LandmarkLocalizer:
    return LandmarkLocalizer(site)


def check_found(answer: Localization, T: Pose, metres: float = 0.3, degrees: float = 2.0) -> None:
    assert answer.localized, answer.message
    delta = geometry.inverse(T) @ answer.T_map_sensor
    assert np.linalg.norm(delta[:3, 3]) < metres
    assert geometry.rotation_angle(delta) < math.radians(degrees)


def test_a_mirror_image_is_refused(site: LandmarkMap) -> None:
    flip = np.array([-1.0, 1.0, 1.0])
    mirrored = dataclasses.replace(site, positions=site.positions * flip, axes=site.axes * flip)
    answer = LandmarkLocalizer(mirrored).localize(stems.seen(stems.stand(1), POSES[0]))
    assert not answer.localized


def test_columns_of_two_storeys_are_told_apart() -> None:
    """They stand above each other, so no answer is right beyond doubt, and none may be false."""
    rng = np.random.default_rng(1)
    feet, diameters = rng.uniform(-40, 40, (150, 2)), rng.uniform(0.2, 0.6, 150)

    def seen(storey_m: float, T: Pose) -> Landmarks:
        columns = np.column_stack([feet, np.full(150, storey_m)])
        local = geometry.transform(geometry.inverse(T), columns)
        near = np.hypot(local[:, 0], local[:, 1]) < 20
        noise = rng.normal(0, 0.03, (near.sum(), 3))
        return Landmarks(local[near] + noise, None, diameters[near])

    def at(x: float, y: float, storey_m: float) -> Pose:
        return geometry.yaw_transform(rng.uniform(-3, 3), (x, y, storey_m + 1.0))

    drives = {
        storey_m: [at(x, y, storey_m) for x in range(-20, 21, 5) for y in (0, 3)]
        for storey_m in (0.0, 3.2)
    }
    for storeys, fewest in (((0.0,), 20), ((0.0, 3.2), 0)):
        views = [(seen(z, T), T) for z in storeys for T in drives[z]]
        localizer = LandmarkLocalizer(LandmarkMap.build(views))
        found = 0
        for k in range(20):
            z = storeys[k % len(storeys)]
            T = at(rng.uniform(-18, 18), rng.uniform(-3, 3), z)
            answer = localizer.localize(seen(z, T))
            if answer.localized:
                check_found(answer, T)
                found += 1
        assert found >= fewest


def test_a_pose_is_found_in_any_order_of_the_landmarks(localizer: LandmarkLocalizer) -> None:
    query = stems.seen(stems.stand(1), POSES[1])
    assert query.diameters is not None
    turned = Landmarks(query.positions[::-1], query.directions[::-1], query.diameters[::-1])
    a, b, again = (localizer.localize(q) for q in (query, turned, query))
    check_found(a, POSES[1])
    assert a.inliers > 40 and a.overlap > 0.7 and a.confidence > 0.9
    np.testing.assert_array_equal(a.T_map_sensor, again.T_map_sensor)
    np.testing.assert_allclose(a.T_map_sensor, b.T_map_sensor, atol=1e-3)


@pytest.mark.parametrize(
    ("count", "reason"),
    [(0, Reason.NO_SEGMENTS), (2, Reason.NO_MATCHES), (4, Reason.TOO_UNCERTAIN)],
)
def test_too_few_landmarks_are_refused(
    localizer: LandmarkLocalizer, count: int, reason: Reason
) -> None:
    whole = stems.seen(stems.stand(1), POSES[1])
    near = np.argsort(np.hypot(*whole.positions[:, :2].T))[:count]
    assert whole.diameters is not None
    few = Landmarks(whole.positions[near], whole.directions[near], whole.diameters[near])
    assert localizer.localize(few).reason is reason


def test_an_empty_map_has_nothing(localizer: LandmarkLocalizer) -> None:
    answer = LandmarkLocalizer(LandmarkMapper().map()).localize(
        stems.seen(stems.stand(1), POSES[0])
    )
    assert answer.reason is Reason.NO_MATCHES


def test_other_things_are_refused(localizer: LandmarkLocalizer) -> None:
    with pytest.raises(InvalidScan, match="a query must be Landmarks, not ndarray"):
        localizer.localize(np.zeros((5, 3)))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"needs a LandmarkMap, not SegmentMap: load one by"):
        LandmarkLocalizer(SegmentMap.empty("geo", "geo-1", 7))  # type: ignore[arg-type]
