"""The filter behind a track, by views made up: no clouds, only log-ratios."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from segloc import geometry
from segloc.tracking.belief import Belief, BeliefConfig, Height, Reading, Status, View
from segloc.types import Pose

HERE = geometry.yaw_transform(0.4, (10.0, 5.0, 0.0))
THERE = geometry.yaw_transform(-2.0, (80.0, -40.0, 0.0))
COVARIANCE = np.diag([1e-5] * 3 + [1e-3] * 3)
FITS, CONTRADICTS, UNMAPPED = 3.0, -3.0, 0.0
STEP_M = 2.0


def alike(metres: float) -> float:
    return math.exp(-metres / 5.0)


class Robot:
    """Drives straight on; its scans fit the map as they are told to."""

    def __init__(self, mount: Pose | None = None, **config: float) -> None:
        self.belief = Belief(BeliefConfig(**config), 0.9, geometry.Separation(), alike)
        self.x, self.mount = 0.0, np.eye(4) if mount is None else mount

    @property
    def T_odom_sensor(self) -> Pose:
        return geometry.yaw_transform(0.0, (self.x, 0.0, 0.0)) @ self.mount

    def views(
        self, *places: tuple[Pose, float, float], new: float = 1.0, searched: bool = True
    ) -> Robot:
        """Take a view that says so much of places, if they were known and if not."""
        found = [
            Reading(T, known, float(known != UNMAPPED), ratio, COVARIANCE)
            for T, known, ratio in places
        ]
        at = self.belief.travelled
        self.belief.update(View(at, self.T_odom_sensor, new, found, searched))
        return self

    def searches(self, *places: tuple[Pose, float], new: float = 1.0) -> Robot:
        return self.views(*((T, 0.0, ratio) for T, ratio in places), new=new)

    def drives(self, metres: float, *evidence: tuple[Pose, float]) -> Robot:
        """Drive on and compare the hypotheses near some poses, each ``STEP_M``."""
        for _ in range(round(metres / STEP_M)):
            self.x += STEP_M
            self.belief.move(STEP_M)
            self.views(*((T, known, 0.0) for T, known in evidence), searched=False)
        return self

    @property
    def status(self) -> Status:
        return self.belief.status()[0]

    @property
    def reason(self) -> str:
        return self.belief.status()[1]

    def is_at(self, T: Pose) -> bool:
        track = self.belief.track
        return track is not None and np.allclose(track.T_map_odom, T)


@pytest.mark.parametrize("meanwhile_m", [0.0, 5.0, 20.0])
def test_a_view_counts_as_from_where_it_was_taken(meanwhile_m: float) -> None:
    robot = Robot().searches((HERE, 8.0)).drives(2.0)
    off = HERE @ geometry.yaw_transform(0.0, (0.5, 0.0, 0.0))
    found = Reading(off, FITS, 1.0, 8.0, COVARIANCE / 10.0)
    view = View(robot.belief.travelled, robot.T_odom_sensor, 1.0, [found], searched=True)
    robot.belief.move(meanwhile_m)  # while the query is answered
    robot.belief.update(view)
    assert robot.is_at(HERE)  # one view moves it less than 0.5 m


def test_the_first_view_gives_the_posterior_of_a_single_query() -> None:
    ratios = np.array([2.0, 1.2, -0.5, 0.0])
    belief = Robot().searches((HERE, 2.0), (THERE, 1.2), (HERE @ THERE, -0.5)).belief
    expected = np.exp(ratios) / np.exp(ratios).sum()
    found = [*(h.probability for h in belief.hypotheses), belief.lost]
    assert found == pytest.approx(expected)
    assert belief.status()[0] is Status.CANDIDATE and belief.track is None
    assert Robot().searches((HERE, 8.0)).status is Status.LOCALIZED
    assert Robot().searches((HERE, -8.0)).status is Status.LOST


def test_a_kidnapped_robot_is_noticed_and_found_however_long_its_track_was_supported() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(400.0, (HERE, FITS))
    track = robot.belief.track
    assert robot.status is Status.LOCALIZED and track is not None and track.views > 100
    robot.drives(6.0, (HERE, CONTRADICTS))
    assert robot.status is Status.LOST and robot.reason == "the map contradicts the track"
    assert robot.searches((THERE, 6.0)).is_at(THERE) and robot.status is Status.LOCALIZED


def test_a_place_that_fits_better_wins_over_a_track_that_still_fits() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(100.0, (HERE, FITS))
    robot.views((HERE, 0.5, 2.0), (THERE, 3.0, 4.0))
    assert not robot.is_at(THERE)  # one view is not enough
    robot.drives(12.0, (HERE, 0.0), (THERE, FITS))
    assert robot.is_at(THERE) and robot.status is Status.LOCALIZED


def test_no_single_view_is_final() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(50.0, (HERE, FITS))
    robot.drives(2.0, (HERE, CONTRADICTS))
    assert robot.drives(4.0, (HERE, FITS)).is_at(HERE) and robot.status is Status.LOCALIZED
    wrong = Robot().searches((THERE, 300.0)).drives(4.0, (THERE, CONTRADICTS))
    assert wrong.status is Status.DEGRADED
    assert wrong.drives(10.0, (THERE, CONTRADICTS)).status is Status.LOST


def test_two_equal_places_are_told_apart_by_what_is_seen_later() -> None:
    robot = Robot().searches((HERE, 9.0), (THERE, 9.0))
    assert robot.status is Status.CANDIDATE and robot.reason == "several places fit"
    robot.drives(20.0, (HERE, FITS), (THERE, FITS))
    assert robot.status is Status.CANDIDATE  # both still fit
    assert robot.drives(4.0, (HERE, FITS), (THERE, CONTRADICTS)).is_at(HERE)


def test_what_was_seen_before_is_no_evidence_but_a_change_is() -> None:
    robot = Robot().searches((HERE, 0.5)).drives(2.0, (HERE, 1.0))
    before = robot.belief.hypotheses[0].probability
    for _ in range(20):
        robot.views((HERE, 1.0, 0.5), new=0.0)
    assert robot.belief.hypotheses[0].probability == pytest.approx(before)
    assert robot.views((HERE, CONTRADICTS, -9.0), new=0.0).status is Status.LOST


def test_beyond_the_map_odometry_carries_on_with_a_growing_covariance_until_it_is_lost() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(50.0, (HERE, FITS))
    seen, widths = [robot.status], [0.0]
    for _ in range(30):
        robot.drives(10.0, (HERE, UNMAPPED))
        seen.append(robot.status)
        if robot.status is Status.DEGRADED:
            assert "supports the track" in robot.reason
            covariance = robot.belief.covariance(robot.T_odom_sensor)
            assert covariance is not None and covariance[3, 3] > widths[-1]
            widths.append(covariance[3, 3])
    changes = [a for a, b in zip(seen, [*seen[1:], None], strict=True) if a is not b]
    assert changes == [Status.LOCALIZED, Status.DEGRADED, Status.LOST]
    assert 80 < 10 * seen.index(Status.LOST) < 200
    assert "supports the track" in robot.reason
    assert robot.drives(8.0, (HERE, FITS)).is_at(HERE)  # back in the map


def test_an_unlikely_place_does_not_end_a_track_and_a_likely_one_ends_an_unsupported_one() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(50.0, (HERE, FITS))
    assert robot.searches((THERE, 2.0)).is_at(HERE)
    robot.drives(80.0, (HERE, UNMAPPED))
    assert robot.searches((THERE, 8.0)).is_at(THERE)


def test_a_jump_of_the_odometry_is_followed_until_the_map_confirms_it() -> None:
    jump = geometry.yaw_transform(1.0, (-7.0, 3.0, 0.0))
    moved = HERE @ geometry.inverse(jump)

    def jumped() -> Robot:
        robot = Robot().searches((HERE, 8.0)).drives(20.0, (HERE, FITS))
        robot.belief.follow_jump(jump, "the odometry jumped")
        assert robot.is_at(moved) and robot.status is Status.DEGRADED
        assert robot.reason == "the odometry jumped"
        return robot

    confirmed = jumped().drives(2.0, (moved, FITS))
    assert confirmed.status is Status.LOCALIZED and confirmed.reason == ""
    assert jumped().drives(4.0, (moved, CONTRADICTS)).status is Status.LOST
    alone = jumped().drives(140.0, (moved, UNMAPPED))
    assert alone.status is Status.LOST and alone.reason == "the odometry jumped"


def test_a_pose_that_is_known_from_elsewhere_needs_views_to_be_believed() -> None:
    def supposed() -> Robot:
        robot = Robot()
        robot.belief.suppose(HERE, robot.T_odom_sensor, 0.6)
        assert robot.status is Status.CANDIDATE and robot.belief.track is None
        return robot

    assert supposed().drives(4.0, (HERE, FITS)).is_at(HERE)
    assert supposed().drives(4.0, (HERE, CONTRADICTS)).status is Status.LOST


def test_a_pose_is_corrected_as_far_as_measurement_and_odometry_allow() -> None:
    def at(x: float) -> Pose:
        return HERE @ geometry.yaw_transform(0.0, (x, 0.0, 0.0))

    def pose(robot: Robot) -> Pose:
        track = robot.belief.track
        assert track is not None
        return geometry.inverse(HERE) @ track.T_map_odom

    robot = Robot().searches((HERE, 8.0))
    assert 0.01 < pose(robot.drives(2.0, (at(0.05), FITS)))[0, 3] < 0.04
    robot.drives(20.0, (at(0.05), FITS))
    assert pose(robot)[0, 3] == pytest.approx(0.05, abs=0.01)
    before, T_sensor = pose(robot), robot.T_odom_sensor
    turned = HERE @ T_sensor @ geometry.yaw_transform(0.14) @ geometry.inverse(T_sensor)
    assert np.allclose(pose(robot.drives(2.0, (turned, FITS))), before)  # one scan alone
    assert robot.drives(2.0, (turned, FITS)).is_at(turned)  # and another


def test_a_leaning_robot_is_corrected_where_planar_odometry_knows_nothing_of_it() -> None:
    def leaning(x: float, degrees: float) -> Pose:
        T_sensor = geometry.yaw_transform(0.0, (x, 0.0, 0.0))
        lean = np.array([np.radians(degrees), 0.0, 0.0, 0.0, 0.0, 0.0])
        return geometry.displace(HERE @ T_sensor, lean) @ geometry.inverse(T_sensor)

    robot = Robot().searches((HERE, 8.0)).drives(10.0, (HERE, FITS))
    robot.drives(2.0, (leaning(12.0, 25.0), FITS))
    assert robot.is_at(HERE)  # one scan alone
    assert robot.drives(2.0, (leaning(14.0, 22.0), FITS)).is_at(leaning(14.0, 22.0))


def test_height_follows_the_map_where_planar_odometry_climbs_stairs() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(10.0, (HERE, FITS))
    for climbed in np.arange(1, 8) * 0.6:
        there = geometry.rigid(HERE[:3, :3], HERE[:3, 3] + [0.0, 0.0, climbed])
        robot.drives(STEP_M, (there, FITS))
        track = robot.belief.track
        assert track is not None and abs(track.T_map_odom[2, 3] - there[2, 3]) < 0.1


def test_hypotheses_that_meet_are_one() -> None:
    beside = geometry.yaw_transform(0.0, (5.0, 0.0, 0.0)) @ HERE
    robot = Robot().searches((HERE, 6.0), (beside, 6.0))
    for h in robot.belief.hypotheses:
        h.T_map_odom = HERE
    robot.drives(2.0, (HERE, FITS))
    assert len(robot.belief.hypotheses) == 1 and robot.is_at(HERE)
    assert robot.belief.hypotheses[0].probability + robot.belief.lost == pytest.approx(1.0)


def test_covariance_grows_with_the_path_and_turns_with_the_robot() -> None:
    robot = Robot().searches((HERE, 8.0))
    first = robot.belief.covariance(np.eye(4))
    assert first is not None and np.allclose(first, COVARIANCE)
    robot.belief.move(15.0)
    ahead = geometry.yaw_transform(0.0, (15.0, 0.0, 0.0))
    later = robot.belief.covariance(ahead)
    assert later is not None
    # Drift of 2 % is 0.3 m; 0.003 rad of the heading is 0.05 m sideways, 15 m ahead.
    assert later[3, 3] == pytest.approx(1e-3 + 0.3**2)
    assert later[4, 4] == pytest.approx(1e-3 + 1e-5 * 15**2 + 0.3**2)
    assert later[0, 0] > 10 * later[2, 2]  # the horizon of odometry is unsure


ABOVE = geometry.yaw_transform(0.4, (10.0, 5.0, 3.2))


def observes(robot: Robot, metres: float, sigma: float = 0.5) -> bool:
    at = robot.belief.travelled
    return robot.belief.observe(Height(metres, sigma, at, robot.T_odom_sensor))


def test_a_height_tells_storeys_apart_that_fit_alike_and_confirms_none() -> None:
    robot = Robot().searches((HERE, 9.0), (ABOVE, 9.0), (THERE, 9.0))
    lost = robot.belief.lost
    assert not observes(robot, 3.0) and robot.is_at(ABOVE)
    assert robot.belief.hypotheses[0].probability > 0.99
    assert robot.belief.lost > lost
    for _ in range(50):  # the errors of a barometer are alike: it counts once
        observes(robot, 0.2)
    ratio = robot.belief.hypotheses[0].probability / robot.belief.lost
    assert robot.is_at(HERE) or robot.is_at(THERE) or robot.status is Status.CANDIDATE
    assert ratio < math.exp(9.0)


def test_a_height_with_a_wide_deviation_or_of_long_ago_tells_little() -> None:
    robot = Robot().searches((HERE, 9.0), (ABOVE, 9.0))
    observes(robot, 3.2, sigma=20.0)
    one, other = (h.probability for h in robot.belief.hypotheses)
    assert one / other < 1.05
    robot = Robot().searches((HERE, 9.0))
    observes(robot, 0.0)
    robot.drives(60.0, (HERE, FITS))  # stairs, of which a planar odometry knows nothing
    robot.views((HERE, CONTRADICTS, -9.0), (ABOVE, 0.0, 9.0))
    assert robot.belief.hypotheses[0].height > -0.1


def test_a_wrong_height_costs_a_track_once_and_views_outweigh_it() -> None:
    robot = Robot().searches((HERE, 8.0)).drives(40.0, (HERE, FITS))
    before = robot.belief.hypotheses[0].probability / robot.belief.lost
    assert observes(robot, 50.0) and robot.reason == "the height contradicts the track"
    for _ in range(100):
        assert not observes(robot, 50.0)
    after = robot.belief.hypotheses[0].probability / robot.belief.lost
    assert before / after < 600.0
    assert robot.drives(20.0, (HERE, FITS)).is_at(HERE) and robot.status is Status.LOCALIZED
    robot = Robot().searches((HERE, 8.0)).drives(40.0, (HERE, FITS))
    observes(robot, 50.0)
    observes(robot, 0.0)
    assert robot.is_at(HERE) and robot.status is Status.LOCALIZED


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees", [-90.0, 45.0, 90.0, 180.0])
def test_places_are_told_apart_however_the_sensor_is_mounted(axis: str, degrees: float) -> None:
    turned = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    mount = geometry.rigid(turned, np.array([0.0, 0.0, 1.0]))
    about = HERE @ geometry.yaw_transform(np.pi)
    above = geometry.rigid(np.eye(3), np.array([0.0, 0.0, 2.9])) @ HERE
    for other in (about, above):
        robot = Robot(mount).searches((HERE, 4.0), (other, 4.0))
        assert len(robot.belief.hypotheses) == 2 and robot.status is Status.CANDIDATE
