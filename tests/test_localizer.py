"""Map and localize: the pipeline as its users see it."""

from __future__ import annotations

import itertools
import math
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence

from segloc import (
    Config,
    Localizer,
    MapMismatch,
    Prior,
    Scan,
    SegmentMap,
    build_map,
    geometry,
)
from segloc.config import map_config
from segloc.errors import ConfigError
from segloc.localization import Localization, Reason
from segloc.proposals.proposer import Query
from segloc.types import Candidate, Float64, Matches, Pose

GEO = Config.preset("geo")


def pose_error(result: Localization, T: np.ndarray) -> tuple[float, float]:
    assert result.T_map_sensor is not None, result.reason
    delta = geometry.inverse(T) @ result.T_map_sensor
    return float(np.linalg.norm(delta[:3, 3])), math.degrees(geometry.rotation_angle(delta))


@pytest.mark.parametrize(("yaw", "posed"), [(1.0, True), (math.pi, False), (-2.0, False)])
def test_a_single_scan_is_localized(
    plaza: Plaza, localizer: Localizer, yaw: float, posed: bool
) -> None:
    T = geometry.yaw_transform(yaw, (3.0, -2.0, 1.7))
    result = localizer.localize(plaza.scan(T, posed=posed, seed=77))
    metres, degrees = pose_error(result, T)
    assert result.localized and result.reason is None and metres < 0.1 and degrees < 0.5
    assert result.inliers >= 6 and result.overlap > 0.8 and result.confidence > 0.9
    assert result.covariance is not None
    assert (np.linalg.eigvalsh(result.covariance) > 0).all()


def test_accumulated_scans_are_localized_whatever_the_odometry_frame(
    plaza: Plaza, localizer: Localizer
) -> None:
    way = PlazaSequence(plaza, steps=10).poses
    T_odom_world = geometry.yaw_transform(2.5, (500.0, -300.0, 20.0))
    scans = deque[Scan](maxlen=10)
    for k, T in enumerate(way):
        seen = plaza.scan(T, seed=100 + k)
        scans.append(Scan(seen.points, stamp=float(k), T_odom_sensor=T_odom_world @ T))
    result = localizer.localize(scans)
    assert pose_error(result, way[-1]) < (0.1, 0.5)
    assert result.stamp == 9.0 and result.counts["scans"] == 10


def test_a_tilted_sensor_with_a_pose_is_localized(plaza: Plaza, localizer: Localizer) -> None:
    c, s = math.cos(0.15), math.sin(0.15)
    tilt = geometry.rigid(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.zeros(3))
    T = geometry.yaw_transform(0.7, (1.0, 2.0, 1.7)) @ tilt
    assert pose_error(localizer.localize(plaza.scan(T, seed=5)), T) < (0.1, 0.5)


def test_another_place_is_not_localized(localizer: Localizer) -> None:
    for seed in range(1, 4):
        elsewhere = Plaza(seed).scan(geometry.yaw_transform(0.3, (0.0, 0, 1.7)))
        result = localizer.localize(elsewhere)
        assert not result.localized and result.T_map_sensor is None and result.covariance is None
        assert result.reason and result.counts["segments"] > 10


EMPTY: dict[str, Callable[[], np.ndarray]] = {
    "nothing": lambda: np.empty((0, 3)),
    "NaN": lambda: np.full((1000, 3), np.nan),
    "inf": lambda: np.full((10, 3), np.inf),
    "far away": lambda: np.full((100, 3), 1e6),
}
POOR: dict[str, Callable[[], np.ndarray]] = {
    "one point": lambda: np.zeros((1, 3)),
    "three points": lambda: np.eye(3),
    "one point many times": lambda: np.zeros((20_000, 3)),
    "a line": lambda: np.linspace([0, 0, 0], [40.0, 0, 0], 2000),
    "a flat floor": lambda: np.random.default_rng(0).uniform([-30, -30, 0], [30, 30, 0], (9999, 3)),
    "noise": lambda: np.random.default_rng(0).normal(0, 15, (20_000, 3)),
}


@pytest.mark.parametrize("name", [*EMPTY, *POOR])
def test_poor_scans_are_not_localized_and_say_why(localizer: Localizer, name: str) -> None:
    result = localizer.localize(Scan({**EMPTY, **POOR}[name]()))
    assert not result.localized and result.T_map_sensor is None
    assert result.reason is Reason.NO_POINTS if name in EMPTY else result.message


@pytest.mark.parametrize("size", [0, 1, 3])
def test_maps_of_almost_nothing_localize_nothing(
    plaza: Plaza, plaza_map: SegmentMap, size: int
) -> None:
    few = (np.arange(len(part)) < size for part in (plaza_map, plaza_map.cloud))
    small = plaza_map.kept(*few)
    result = Localizer(small).localize(plaza.scan(np.eye(4)))
    assert not result.localized and result.T_map_sensor is None and result.reason


def test_a_map_of_another_descriptor_is_refused(plaza_map: SegmentMap) -> None:
    other = SegmentMap.empty(plaza_map.descriptor, "another-fingerprint", plaza_map.dim)
    with pytest.raises(MapMismatch, match="another-fingerprint"):
        Localizer(other)
    nonesuch = SegmentMap.empty("nonesuch", plaza_map.fingerprint, plaza_map.dim)
    with pytest.raises(ConfigError, match="no method"):
        Localizer(nonesuch)
    with pytest.raises(MapMismatch, match="'nonesuch', but the configuration is of method 'geo'"):
        Localizer(nonesuch, Config.preset("geo"))


def test_the_same_query_gives_the_same_bits_for_any_number_of_threads(
    plaza: Plaza, plaza_map: SegmentMap
) -> None:
    scan = plaza.scan(geometry.yaw_transform(1.0, (3.0, -2.0, 1.7)))
    results = [
        Localizer(plaza_map, GEO.model_copy(update={"threads": n})).localize(scan)
        for n in (1, 2, 8)
    ]
    for result in results[1:]:
        np.testing.assert_array_equal(result.T_map_sensor, results[0].T_map_sensor)
        np.testing.assert_array_equal(result.covariance, results[0].covariance)
        assert (result.inliers, result.overlap) == (results[0].inliers, results[0].overlap)


def test_nothing_that_localizes_imports_torch() -> None:
    """In a fresh interpreter, since other tests of this run may have imported it."""
    import subprocess

    code = (
        "import sys, segloc; from segloc.descriptors import available; available();"
        "print([m for m in ('torch', 'matplotlib', 'trimesh', 'laspy') if m in sys.modules])"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert output.stdout.strip() == "[]"


def test_a_query_is_configured_as_the_map_was_built(plaza: Plaza) -> None:
    matching = GEO.matching.model_copy(update={"neighbours": 7})
    segmentation = GEO.segmentation.model_copy(update={"ground_cell": 2.0})
    config = GEO.model_copy(
        update={"matching": matching, "segmentation": segmentation, "threads": 3}
    )
    built = build_map(PlazaSequence(plaza, steps=3), config)
    localizer = Localizer(built)
    assert localizer.config.matching.neighbours == 7 and localizer.config.threads == 0
    assert localizer.notes == (
        "confidence was fitted under other values of matching.neighbours, segmentation.ground_cell",
    )
    default = Localizer(built, GEO)
    assert default.notes == ("not as the map was built: segmentation.ground_cell",)
    assert Localizer(build_map(PlazaSequence(plaza, steps=3), GEO)).notes == ()


def test_the_configuration_of_another_version_or_a_method_not_installed_is_read() -> None:
    foreign = SegmentMap.empty("elsewhere", "f" * 16, 3, np.zeros(3))
    gone = "mapping: {cloud_voxel: 0.7, gone: 1}\nverification: {refined_from: 0.9}\nstems: {}\n"
    foreign.metadata["config"] = f"method: elsewhere\n{gone}"
    assert map_config(foreign).mapping.cloud_voxel == 0.7


def test_a_map_without_a_readable_configuration_uses_the_preset(plaza_map: SegmentMap) -> None:
    other = plaza_map.crop((0.0, 0.0), np.inf)
    for text in ("", ": [", "nonsense: 1", "- 1", "method: dsm"):
        other.metadata["config"] = text
        assert Localizer(other).config == GEO


def test_where_segments_say_little_every_proposal_is_measured(plaza_map: SegmentMap) -> None:
    localizer = Localizer(plaza_map)
    query = localizer.describe(Plaza(1).scan(geometry.yaw_transform(0.3, (0.0, 0, 1.7))))
    found = localizer.search(query)
    assert found.reason is not None
    where = query.scene.segments.centroids, plaza_map.centroids
    poses = {c.T_map_local.tobytes() for c in found.candidates}
    tried = localizer.estimator.estimate(*where, found.matches)
    assert tried and {c.T_map_local.tobytes() for c in tried} <= poses
    agree = localizer.estimator.agreement(*where, found.matches)
    assert all(c.inliers == agree(c.T_map_local) for c in found.candidates if c.fit is not None)
    assert "occupancy" in {c.proposer for c in found.candidates}


@dataclass
class Given:
    """A proposer and estimator that knows one pose."""

    T_map_local: Pose
    name: str = "own"

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        return [Candidate(self.T_map_local, 0, 0.9)]

    def estimate(self, query: Float64, map_centroids: Float64, matches: Matches) -> list[Candidate]:
        return [Candidate(self.T_map_local, 20)]

    def agreement(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> Callable[[Pose], int]:
        return lambda T: 20 if np.allclose(T[:3, 3], self.T_map_local[:3, 3], atol=2.0) else 0


@pytest.mark.parametrize("name", ["proposers", "estimator"])
@pytest.mark.parametrize("shift_m", [0.0, 40.0])
def test_poses_of_a_proposer_or_estimator_of_ones_own_are_verified(
    plaza: Plaza, plaza_map: SegmentMap, name: str, shift_m: float
) -> None:
    true = geometry.yaw_transform(1.0, (3.0, -2.0, 1.7))
    own = Given(geometry.yaw_transform(1.0, (3.0 + shift_m, -2.0, 1.7)))
    parts: dict[str, Any] = {"estimator": own, "proposers": [own] if name == "proposers" else []}
    localizer = Localizer(plaza_map, **parts)
    found = localizer.localize(plaza.scan(true))
    assert found.localized == (shift_m == 0.0), found.message
    if found.localized:
        assert np.linalg.norm(found.T_map_sensor[:3, 3] - true[:3, 3]) < 0.3


@pytest.mark.parametrize("by_segments", [True, False])
def test_an_answer_names_its_proposer(
    plaza: Plaza, plaza_map: SegmentMap, by_segments: bool
) -> None:
    true = geometry.yaw_transform(1.0, (3.0, -2.0, 1.7))
    nowhere = Given(geometry.yaw_transform(2.0, (300.0, 200.0, 1.7)))
    estimator = None if by_segments else nowhere
    localizer = Localizer(plaza_map, estimator=estimator, proposers=[Given(true)])
    found = localizer.localize(plaza.scan(true))
    assert found.localized
    assert found.proposer == ("segments" if by_segments else "own")


def test_nothing_more_is_tried_after_the_deadline(plaza_map: SegmentMap) -> None:
    ticks = itertools.count()
    localizer = Localizer(plaza_map, clock=lambda: float(next(ticks)))
    elsewhere = Plaza(1).scan(geometry.yaw_transform(0.3, (0.0, 0, 1.7)))
    looking, describing, matching, verifying = 3, 3, 3, 1  # stages, each of which takes a second
    everything = looking + describing + matching + 1 + verifying  # one proposer
    requested = {None: everything, 1e9: everything, 0.0: everything - 1, 8.5e3: everything - 1}
    for deadline_ms, seconds in requested.items():
        found = localizer.localize(elsewhere, deadline_ms=deadline_ms)
        assert not found.localized and found.times_ms["total"] == 1e3 * seconds


def test_every_stage_has_its_own_time(plaza: Plaza, plaza_map: SegmentMap) -> None:
    ticks = itertools.count()
    localizer = Localizer(plaza_map, clock=lambda: float(next(ticks)))
    seen = localizer.localize(plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7))))
    looking = ["gathering", "segmentation", "pose"]
    assert seen.proposer == "first sight"
    assert list(seen.times_ms) == [*looking, "verification", "total"]
    assert seen.times_ms["gathering"] == 1000.0 and seen.times_ms["total"] == 4000.0
    times = localizer.localize(Plaza(1).scan(geometry.yaw_transform(0.3, (0.0, 0, 1.7)))).times_ms
    matching = ["preprocessing", "descriptor", "matching", "pruning"]
    assert list(times) == [*looking, *matching, "verification", "total"]


def test_a_view_that_fixes_no_place_says_so(plaza_map: SegmentMap) -> None:
    """A wall, and a corridor's two, slide along themselves; a corner does not."""
    rng, count = np.random.default_rng(0), 4000
    along, up = rng.uniform(-6, 6, count), rng.uniform(-1.0, 1.5, count)
    wall = np.column_stack([np.full(count, 2.0), along, up]) + rng.normal(0, 0.01, (count, 3))
    opposite, across = wall * (-1, 1, 1), wall[:, [1, 0, 2]]
    localizer = Localizer(plaza_map)
    for views, slides in (([wall], True), ([wall, opposite], True), ([wall, across], False)):
        found = localizer.localize(np.float32(np.concatenate(views)))
        assert not found.localized and (found.reason is Reason.TOO_LITTLE_IN_VIEW) == slides


def test_segments_that_decide_alone_in_a_large_map_have_more_matches(
    plaza: Plaza, plaza_map: SegmentMap
) -> None:
    scan = plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)))
    few = {"neighbours": 2, "growth": 0.0, "matches": 1}

    def proposed(large: bool, occupancy: bool) -> int:
        matching = few | {"grows_from": 10 if large else 10_000}
        sections = {"matching": matching, "occupancy": {"enabled": occupancy}, "method": "geo"}
        config = Config.model_validate(sections | {"first_sight": {"enabled": False}})
        return Localizer(plaza_map, config).localize(scan).counts["proposed"]

    assert proposed(large=True, occupancy=False) == 4 * proposed(large=True, occupancy=True)
    assert proposed(large=False, occupancy=False) == proposed(large=False, occupancy=True)
