"""The bookkeeping behind a track, by views made up: what was seen last counts."""

from __future__ import annotations

import numpy as np
import pytest

from segloc import geometry
from segloc.tracking.hypotheses import UNCONFIRMED, Hypotheses
from segloc.tracking.views import Check, HypothesesConfig, Status, View
from segloc.types import Pose

HERE = geometry.yaw_transform(0.4, (10.0, 5.0, 0.0))
THERE = geometry.yaw_transform(-2.0, (80.0, -40.0, 0.0))
COVARIANCE = np.diag([1e-4] * 3 + [1e-2] * 3)


def view(at: float, T: Pose | None = None, believed: bool = True, **more: object) -> View:
    where = geometry.yaw_transform(0.0, (at, 0.0, 0.0))
    confidence = 0.95 if believed else 0.5
    return View(at, where, T, confidence, believed and T is not None, COVARIANCE, **more)  # type: ignore[arg-type]


def after(*views: View, config: HypothesesConfig | None = None) -> Hypotheses:
    hypotheses = Hypotheses(config)
    for each in views:
        hypotheses.take(each)
    return hypotheses


def at(hypotheses: Hypotheses, T: Pose) -> bool:
    return hypotheses.track is not None and np.allclose(hypotheses.track.T_map_odom, T)


def test_a_long_track_ends_with_two_contradictions_and_not_with_one() -> None:
    long = [view(10.0 * k, HERE) for k in range(30)]
    assert after(*long).track.views == 30  # type: ignore[union-attr]
    one = after(*long, view(300.0, check=Check.CONTRADICTS))
    assert at(one, HERE) and one.status(300.0)[0] is Status.DEGRADED and one.contradicted
    one.take(view(304.0, HERE, check=Check.HOLDS, T_checked=HERE))
    assert one.status(304.0) == (Status.DEGRADED, UNCONFIRMED) and not one.contradicted
    one.take(view(308.0, HERE, check=Check.HOLDS, T_checked=HERE))  # for as long as not
    assert one.status(308.0) == (Status.LOCALIZED, "")
    two = after(*long, *(view(300.0 + k, HERE, check=Check.CONTRADICTS) for k in (0, 4)))
    # The clouds of queries still hold what was seen before: what they say does not count.
    assert two.track is None
    assert two.status(304.0) == (Status.LOST, "the map contradicts the track")


def test_another_place_that_is_believed_takes_over_once_two_views_say_so() -> None:
    long = [view(10.0 * k, HERE) for k in range(10)]
    first = after(*long, view(100.0, THERE))
    assert at(first, HERE) and first.status(100.0)[0] is Status.DEGRADED
    first.take(view(110.0, THERE))
    assert at(first, THERE) and first.status(110.0)[0] is Status.LOCALIZED
    back = after(*long, view(100.0, THERE), view(110.0, HERE), view(120.0, HERE))
    assert at(back, HERE) and back.status(120.0)[0] is Status.LOCALIZED


def test_a_place_that_looks_alike_does_not_outweigh_what_holds() -> None:
    long = [view(10.0 * k, HERE) for k in range(10)]
    holds = {"check": Check.HOLDS, "T_checked": HERE}
    track = after(*long, *(view(100.0 + 10 * k, THERE, **holds) for k in range(3)))
    assert at(track, HERE) and track.status(120.0)[0] is Status.LOCALIZED
    young = after(view(0.0, HERE), *(view(10.0 * k, THERE, **holds) for k in (1, 2)))
    assert young.status(20.0)[0] is not Status.LOCALIZED  # it is chance which came first


def test_likely_views_must_agree_and_two_places_alike_are_a_contradiction() -> None:
    weak = after(view(0.0, HERE, believed=False))
    assert weak.status(0.0) == (Status.CANDIDATE, "no agreement yet")
    weak.take(view(1.0, HERE, believed=False))  # from the same place: no second witness
    assert weak.track is None
    weak.take(view(5.0, HERE, believed=False))
    assert at(weak, HERE)
    both = [view(10.0 * k, (HERE, THERE)[k % 2], believed=False) for k in range(2)]
    both += [view(20.0, HERE, believed=False)]
    assert at(after(*both), HERE)


def test_where_places_are_alike_views_must_agree_for_some_metres() -> None:
    alike = view(0.0, None, ambiguous=True)
    lone = after(alike, view(2.0, HERE))
    assert lone.track is None and lone.status(2.0)[0] is Status.CANDIDATE
    agreed = [view(2.0 * k, HERE) for k in range(1, 7)]
    assert after(alike, *agreed[:-1]).track is None
    assert at(after(alike, *agreed), HERE)
    again = view(7.0, None, ambiguous=True)
    assert after(alike, *agreed[:3], again, *agreed[3:]).track is None
    assert at(after(*agreed[:1], again), HERE)  # there was a track: nothing speaks against it


def test_a_jump_of_the_odometry_is_followed_until_the_map_confirms_it() -> None:
    jump = geometry.yaw_transform(1.0, (-7.0, 3.0, 0.0))
    moved = HERE @ geometry.inverse(jump)
    track = after(view(0.0, HERE))
    track.carry(jump, 0.0, "the odometry jumped")
    assert at(track, moved) and track.status(0.0) == (Status.DEGRADED, "the odometry jumped")
    confirmed = view(5.0, check=Check.HOLDS, T_checked=moved)
    track.take(confirmed)
    assert track.status(5.0)[0] is Status.LOCALIZED
    alone = after(view(0.0, HERE))
    alone.carry(jump, 0.0, "the odometry jumped")
    alone.forget(21.0)
    assert alone.status(21.0) == (Status.LOST, "the odometry jumped")
    refuted = after(view(0.0, HERE))
    refuted.carry(jump, 0.0, "the odometry jumped")
    refuted.take(view(2.0, check=Check.CONTRADICTS))
    assert refuted.track is None


def test_covariance_grows_with_the_path_and_turns_with_the_robot() -> None:
    track = after(view(0.0, HERE))
    here = np.eye(4)
    first = track.covariance(0.0, here)
    assert first is not None and np.allclose(first, COVARIANCE)
    ahead = geometry.yaw_transform(0.0, (50.0, 0.0, 0.0))
    later = track.covariance(50.0, ahead)
    assert later is not None
    # 50 m ahead a turn of 0.01 rad is half a metre sideways, beside 1 m of drift.
    assert later[4, 4] == pytest.approx(1e-2 + 1e-4 * 50.0**2 + 1.0)
    assert later[3, 3] == pytest.approx(1e-2 + 1.0)


def test_a_covariance_is_carried_as_small_motions_are() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(6, 6))
    T_a_b = geometry.upright(np.array([0.3, -0.2, 1.0])) @ geometry.yaw_transform(0.7, (1, 2, 3))
    small = 1e-5 * rng.normal(size=6)

    def motion(delta: np.ndarray) -> Pose:
        from scipy.spatial.transform import Rotation

        return geometry.rigid(Rotation.from_rotvec(delta[:3]).as_matrix(), delta[3:])

    moved = T_a_b @ motion(small) @ geometry.inverse(T_a_b)
    assert np.allclose(moved, motion(geometry.adjoint(T_a_b) @ small), atol=1e-9)
    A = geometry.adjoint(T_a_b)
    assert np.allclose(geometry.carried_covariance(half @ half.T, T_a_b), A @ half @ half.T @ A.T)
