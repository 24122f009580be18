"""Localization where it is known roughly where the sensor is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from samples.maps import occupancy, repeated
from samples.plaza import Plaza

from segloc import Config, ConfigError, Localizer, Prior, Reason, SegmentMap, geometry
from segloc.proposals.pose import PoseEstimator
from segloc.proposals.proposer import Query
from segloc.tools.cli.options import parsed_prior
from segloc.types import Candidate, Pose

GEO = Config.preset("geo").model_copy(update={"threads": 1})
AWAY = np.array([300.0, 40.0, 0.0])
TRUE = geometry.yaw_transform(1.0, (3.0, -2.0, 1.7))


@pytest.fixture(scope="module")
def twice(plaza_map: SegmentMap) -> SegmentMap:
    """The same place a second time, elsewhere."""
    return repeated(plaza_map, AWAY)


def test_a_prior_tells_two_places_apart_that_look_alike(plaza: Plaza, twice: SegmentMap) -> None:
    localizer, scan = Localizer(twice), plaza.scan(TRUE, seed=77)
    result = localizer.localize(scan)
    assert result.reason is Reason.AMBIGUOUS and result.T_map_sensor is None
    assert len(result.places) > 1
    for shift in (0 * AWAY, AWAY):
        for near in [((3.0 + shift[0], 4.0 + shift[1]), 20.0), Prior(TRUE[:3, 3] + shift, 9.0)]:
            found = localizer.localize(scan, near=near)
            assert found.localized, found.message
            assert np.linalg.norm(found.T_map_sensor[:3, 3] - TRUE[:3, 3] - shift) < 0.3


@pytest.mark.parametrize(
    ("position", "radius"),
    [((5000.0, 0.0), 100.0), ((33.0, -2.0), 10.0), ((3, -2, 60.0), 15.0)],
)
def test_a_wrong_prior_is_named_and_no_pose_is_given(
    plaza: Plaza, plaza_map: SegmentMap, position: Any, radius: float
) -> None:
    localizer, scan = Localizer(plaza_map), plaza.scan(TRUE, seed=77)
    result = localizer.localize(scan, near=(position, radius))
    assert not result.localized and result.reason is Reason.NOT_NEAR_PRIOR
    assert f"within {radius:g} m of {position[0]:.0f}" in result.message
    assert "\n" not in result.message
    anywhere = localizer.localize(scan, near=Prior(position, radius, anywhere=True))
    without = localizer.localize(scan)
    assert anywhere.localized and np.array_equal(anywhere.T_map_sensor, without.T_map_sensor)


@pytest.mark.parametrize(
    "near",
    [
        Prior((5.0, -2.0), 1.0),
        Prior(heading_deg=np.degrees(1.0) + 11.0, heading_tolerance_deg=10.0),
    ],
)
def test_no_answer_lies_outside_of_its_prior(
    plaza: Plaza, plaza_map: SegmentMap, near: Prior
) -> None:
    """Even if it was proposed within, and what fits is just beyond."""
    localizer, scan = Localizer(plaza_map), plaza.scan(TRUE, seed=77)
    result = localizer.localize(scan, near=near)
    assert not result.localized and result.reason is Reason.NOT_NEAR_PRIOR
    assert localizer.localize(scan, near=replace(near, anywhere=True)).localized


class ProposesNothing(PoseEstimator):
    def estimate(self, *_: Any) -> list[Candidate]:
        return []


class Proposes:
    """Proposes one pose."""

    name = "rough"

    def __init__(self, T_map_local: Pose) -> None:
        self.T_map_local = T_map_local

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        return [Candidate(self.T_map_local, 0, 0.5)]


@pytest.mark.parametrize(
    "near",
    [
        Prior(TRUE[:2, 3], 0.3),
        Prior(heading_deg=np.degrees(1.0), heading_tolerance_deg=2.0),
        Prior(height_m=TRUE[2, 3], height_tolerance_m=0.3),
    ],
)
def test_a_rough_proposal_beside_a_tight_prior_is_aligned_first(
    plaza: Plaza, plaza_map: SegmentMap, near: Prior
) -> None:
    rough = TRUE @ geometry.yaw_transform(np.radians(4.0), (0.5, -0.4, 0.5))
    assert not near.holds(rough)
    localizer = Localizer(
        plaza_map, estimator=ProposesNothing(GEO.pose), proposers=[Proposes(rough)]
    )
    scan = plaza.scan(TRUE, seed=77)
    found = localizer.localize(scan, near=near)
    assert found.localized and near.holds(found.T_map_sensor), found.message
    elsewhere = Prior(TRUE[:2, 3] + [2.0, 0.0], 1.5)
    assert elsewhere.widened(localizer.config.pose.separation).holds(rough)
    assert localizer.localize(scan, near=elsewhere).reason is Reason.NOT_NEAR_PRIOR


def test_a_known_pose_is_answered_where_nothing_is_proposed(
    plaza: Plaza, plaza_map: SegmentMap
) -> None:
    estimator = ProposesNothing(GEO.pose)
    localizer = Localizer(plaza_map, estimator=estimator, proposers=())
    query = localizer.describe(plaza.scan(TRUE, seed=77))
    assert localizer.answer(query)[1].reason is Reason.NO_CONSISTENT_MATCHES
    found, result = localizer.answer(query, known=[TRUE])
    assert not found.candidates and result.localized and result.confidence > 0.99


def test_stages_that_compare_clouds_keep_to_the_prior(plaza: Plaza, twice: SegmentMap) -> None:
    localizer = Localizer(twice)
    query = localizer.describe(plaza.scan(TRUE, seed=77))
    for near in (Prior((3.0, -2.0), 25.0), Prior(AWAY[:2] + (3.0, -2.0), 25.0)):
        found = occupancy(localizer).propose(query, near)
        assert found and all(near.holds(c.T_map_local) for c in found)
        fits = np.linalg.norm(found[0].T_map_local[:2, 3] - np.asarray(near.position))
        assert fits < 2.0
        searched = localizer.search(query, near=near)
        assert all(near.holds(c.T_map_local) for c in searched.candidates)
        reach = near.radius_m + localizer.config.local_cloud.radius_m
        rows = twice.centroids[searched.matches.map]
        assert (near.distances(rows) <= reach).all()
    everywhere = occupancy(localizer).propose(query)
    places = np.stack([c.T_map_local[:3, 3] for c in everywhere])
    assert (places[:, 0] < 150).any() and (places[:, 0] > 150).any()


@pytest.mark.parametrize(
    "near",
    [
        5.0, (1.0, 2.0, 3.0), ((1.0,), 5.0), (("a", "b"), 5.0), ((1.0, np.nan), 5.0),
        ((1.0, 1e300), 5.0), ((0.0, 0.0), 0.0), ((0.0, 0.0), -1.0), ((0.0, 0.0), np.inf),
        ((0.0, 0.0), "wide"), "here", ((0.0, 0.0), 5.0, "north"), ((0.0, 0.0), 5.0, np.nan),
        ((0.0, 0.0), 5.0, 1.0, 2.0),
    ],
)  # fmt: skip
def test_what_is_no_prior_is_refused(near: Any) -> None:
    with pytest.raises(ConfigError, match="prior") as caught:
        Prior.of(near)
    assert "\n" not in str(caught.value)


def test_a_heading_excludes_poses_that_face_elsewhere(plaza: Plaza, plaza_map: SegmentMap) -> None:
    localizer = Localizer(plaza_map, GEO)
    scan, truth = plaza.scan(TRUE, posed=False, seed=77), np.degrees(geometry.heading(TRUE))
    for turn, found in ((-30.0, True), (360.0, True), (180.0, False)):
        near = (TRUE[:2, 3], 10.0, truth + turn)
        result = localizer.localize(scan, near=near)
        assert result.localized is found
    assert result.reason is Reason.NOT_NEAR_PRIOR and "heading" in result.message
    for text, position, heading in (
        ("1,2", [1, 2], None), ("1,2,3", [1, 2, 3], None), ("1,2,3,90", [1, 2, 3], 90.0),
        ("1,2,,-90", [1, 2], -90.0),
    ):  # fmt: skip
        prior = parsed_prior(text, 5.0, False)
        assert np.array_equal(prior.position, position) and prior.heading_deg == heading
    for text in ("1", "1,2,3,4,5", "1,b", "1,2,3,north"):
        with pytest.raises(ConfigError, match="--near expects"):
            parsed_prior(text, 5.0, False)


def test_a_height_selects_a_storey_with_a_position_or_without(
    plaza: Plaza, plaza_map: SegmentMap
) -> None:
    up = np.array([0.0, 0.0, 30.0])
    localizer, scan = Localizer(repeated(plaza_map, up, 2 * up)), plaza.scan(TRUE, seed=77)
    assert localizer.localize(scan).reason is Reason.AMBIGUOUS
    for storey in range(3):
        z = TRUE[2, 3] + storey * up[2]
        for near in (Prior(height_m=z + 1.0), Prior(TRUE[:2, 3], 9.0, height_m=z - 1.0)):
            found = localizer.localize(scan, near=near)
            assert found.localized, found.message
            assert np.linalg.norm(found.T_map_sensor[:3, 3] - TRUE[:3, 3] - storey * up) < 0.3
    for height in (-20.0, 12.0, 90.0):
        result = localizer.localize(scan, near=Prior(height_m=height))
        assert not result.localized and result.reason is Reason.NOT_NEAR_PRIOR
        assert f"height {height:.1f} +- 1.5 m" in result.message
    assert "at heights from" in result.message
    assert localizer.localize(scan, near=Prior(height_m=12.0, anywhere=True)).reason is (
        Reason.AMBIGUOUS
    )


def test_a_height_on_the_command_line() -> None:
    prior = parsed_prior(None, 5.0, True, "3.2")
    assert prior is not None and prior.height_m == 3.2 and prior.anywhere
    assert not prior.has_position and str(prior) == "height 3.2 +- 1.5 m"
    prior = parsed_prior("1,2", 5.0, False, "3.2,0.5")
    assert prior is not None and str(prior) == "within 5 m of 1, 2, height 3.2 +- 0.5 m"
    for text in ("up", "", "1,2,3", "1,"):
        with pytest.raises(ConfigError, match="--height expects"):
            parsed_prior(None, 5.0, False, text)
    for text in ("nan", "inf", "1,0", "1,nan", "1,-2"):
        with pytest.raises(ConfigError, match="prior: the height"):
            parsed_prior(None, 5.0, False, text)
    with pytest.raises(ConfigError, match="radius"):
        Prior()
