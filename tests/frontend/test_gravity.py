"""Which way is up in a scan: on simulated and real scans, and what a local cloud makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from samples.plaza import Plaza
from scipy.spatial.transform import Rotation

from segloc import InvalidScan, Scan, _native, geometry
from segloc.frontend.gravity import Attitude, AttitudeConfig, AttitudeEstimator, angle_deg
from segloc.frontend.local_cloud import Accumulator, LocalCloudConfig
from segloc.frontend.mounting import MountConfig, rotation
from segloc.types import Float32, Float64

Z = np.array([0.0, 0.0, 1.0])
ESTIMATOR = AttitudeEstimator()
ACCUMULATOR = Accumulator()


def turn(rng: np.random.Generator, tilt_deg: float) -> Float64:
    """A rotation that tilts z by so much, any way, and turns any way about it."""
    axis, yaw = rng.uniform(0, 2 * np.pi, 2)
    tilt = np.radians(tilt_deg) * np.array([np.cos(axis), np.sin(axis), 0.0])
    R: Float64 = (Rotation.from_rotvec(tilt) * Rotation.from_rotvec([0, 0, yaw])).as_matrix()
    return R


def turned(points: Float32, R: Float64) -> Float32:
    return np.asarray(points @ R.T, dtype=np.float32)


def estimate(points: Float32, expected: Float64 = Z) -> Attitude:
    found = ESTIMATOR.estimate(points, expected)
    assert found is not None
    return found


def room(rng: np.random.Generator, count: int = 20_000) -> Float32:
    """Floor, ceiling and four walls of 12 x 8 x 3 m around the origin, with 1 cm of noise."""
    points = rng.uniform(-1, 1, (count, 3)) * [6, 4, 1.5]
    face = rng.integers(0, 3, count)
    rows = np.arange(count)
    points[rows, face] = np.copysign(np.array([6, 4, 1.5])[face], points[rows, face])
    return np.asarray(points + rng.normal(0, 0.01, points.shape), np.float32)


def flat_normals(points: Float32, radius: float, least: int, most: int) -> Float32:
    """Of points that each have a voxel of their own."""
    return _native.flat_normals(points, 20.0, 1e-4, radius, least, 0.05, most)


def test_up_turns_with_the_scan(plaza: Plaza) -> None:
    seed = 1
    rng = np.random.default_rng(seed)
    for points in (room(rng), plaza.scan(geometry.yaw_transform(seed, (3.0, -2, 1.8))).points):
        level = estimate(points)
        for tilt in (0.0, 5.0, 15.0, 30.0):
            R = turn(rng, tilt)
            found = estimate(turned(points, R))
            assert angle_deg(found.up, R @ level.up) < 0.35
            assert abs(found.tilt_deg - angle_deg(R @ level.up, Z)) < 0.35


def test_true_tilts_are_found(plaza: Plaza) -> None:
    """Of a room, and of a square with boxes on waves of 20 cm."""
    rng = np.random.default_rng(5)
    errors = []
    for k in range(0, 12, 2):
        R = turn(rng, rng.uniform(0, 35))
        T = geometry.rigid(R, np.array([2.0 * k - 12, 5 - k, 1.8]))
        errors.append(angle_deg(estimate(plaza.scan(T).points).up, R.T @ Z))
    assert max(errors) < 1.0, errors
    indoors = [turn(rng, rng.uniform(0, 35)) for _ in range(6)]
    assert max(angle_deg(estimate(turned(room(rng), R)).up, R @ Z) for R in indoors) < 0.2


def test_the_answer_is_the_same_in_any_order_of_points(plaza: Plaza) -> None:
    rng = np.random.default_rng(2)
    points = turned(plaza.scan(geometry.yaw_transform(0.4, (3.0, -2, 1.8))).points, turn(rng, 9))
    first = estimate(points)
    for order in (
        np.arange(len(points)),
        rng.permutation(len(points)),
        np.arange(len(points))[::-1],
    ):
        again = AttitudeEstimator().estimate(np.ascontiguousarray(points[order]))
        assert again is not None and again.sigma_deg == first.sigma_deg
        np.testing.assert_array_equal(again.up, first.up)


def test_what_says_nothing_is_refused() -> None:
    rng = np.random.default_rng(3)
    ball = rng.normal(size=(20_000, 3)) * 4
    wall = np.column_stack([np.full(9000, 5.0), *rng.uniform(-8, 8, (2, 9000))])
    walls = np.concatenate([wall, wall + [6.0, 0, 0]])
    line = np.column_stack([np.linspace(1, 20, 5000), np.zeros(5000), np.zeros(5000)])
    for points in (ball, wall, walls, line, room(rng, 40), np.empty((0, 3)), np.zeros((500, 3))):
        assert ESTIMATOR.estimate(np.asarray(points, np.float32)) is None
    far = room(rng) + np.float32(500.0)
    assert ESTIMATOR.estimate(far) is None  # beyond the radius
    steep = turned(room(rng), turn(rng, 30))
    assert AttitudeEstimator(AttitudeConfig(max_tilt_deg=20)).estimate(steep) is None


@pytest.mark.parametrize("angles", [(0, 90, 0), (180, 0, 0), (90, 0, 45), (-120, 30, 10)])
def test_a_sensor_mounted_at_any_angle(angles: tuple[float, float, float]) -> None:
    """Around where its mounting has the vertical, the estimate is as good as for a level one."""
    rng = np.random.default_rng(6)
    R_base_sensor = rotation(*angles)
    R_world_base = turn(rng, 8.0)
    R = R_world_base @ R_base_sensor  # R_world_sensor
    points = turned(room(rng), R.T)
    assert angle_deg(estimate(points, R_base_sensor.T @ Z).up, R.T @ Z) < 0.2
    T_base_sensor = geometry.rigid(R_base_sensor, np.array([0.1, 0.2, 0.9]))
    mounted = LocalCloudConfig(mount=MountConfig(rpy_deg=angles))
    for cloud in (
        Accumulator(mounted).gather(Scan(points)),
        Accumulator(mounted).gather(Scan(points, T_base_sensor=np.eye(4))),  # the former counts
        ACCUMULATOR.gather(Scan(points, T_base_sensor=T_base_sensor)),
    ):
        assert cloud.attitude == "estimated"
        assert angle_deg(cloud.T_local_sensor[:3, :3].T @ Z, R.T @ Z) < 0.2
        assert np.ptp(cloud.points[:, 2]) < 3.2  # the room stands upright
    nothing = np.asarray(rng.normal(size=(3000, 3)), np.float32)
    cloud = ACCUMULATOR.gather(Scan(nothing, T_base_sensor=T_base_sensor))
    assert cloud.attitude == "assumed"
    assert angle_deg(cloud.T_local_sensor[:3, :3].T @ Z, R_base_sensor.T @ Z) < 1e-5


def test_where_roll_and_pitch_come_from() -> None:
    """Pose, gravity, estimate, in this order; a failure is reported."""
    rng = np.random.default_rng(7)
    R, other = turn(rng, 12), turn(rng, 20)
    points = turned(room(rng), R)
    T = geometry.rigid(R.T, np.zeros(3))
    posed = ACCUMULATOR.gather(Scan(points, T_odom_sensor=T, gravity=other @ -Z))
    assert posed.attitude == "given"
    np.testing.assert_allclose(posed.T_local_sensor[2, :3], R @ Z, atol=1e-12)
    weighed = ACCUMULATOR.gather(Scan(points, gravity=other @ (-9.81 * Z)))
    assert weighed.attitude == "given"
    np.testing.assert_allclose(weighed.T_local_sensor[2, :3], other @ Z, atol=1e-12)
    for error, expected, source in ((15.0, other @ Z, "given"), (90.0, R @ Z, "estimated")):
        rough = ACCUMULATOR.gather(Scan(points, gravity=other @ -Z, gravity_error_deg=error))
        assert rough.attitude == source
        assert angle_deg(rough.T_local_sensor[2, :3], expected) < 0.2
    alone = ACCUMULATOR.gather(points)
    assert alone.attitude == "estimated"
    assert angle_deg(alone.T_local_sensor[2, :3], R @ Z) < 0.2
    np.testing.assert_allclose(
        alone.points, geometry.transform(alone.T_local_sensor, points), atol=1e-5
    )
    off = Accumulator(LocalCloudConfig(attitude=AttitudeConfig(estimate=False)))
    level = off.gather(points)
    assert level.attitude == "given"
    np.testing.assert_array_equal(level.T_local_sensor, np.eye(4))


@pytest.mark.parametrize(
    "gravity", [[0, 0, 0], [0, np.nan, -1], [0, 0, -np.inf], [0, -1], [[0, 0, -1]], "down", 9.81]
)
def test_what_is_no_gravity_is_refused(gravity: object) -> None:
    with pytest.raises(InvalidScan, match="gravity"):
        Scan(np.zeros((1, 3)), gravity=gravity)  # type: ignore[arg-type]
    for error in (-1.0, np.nan, 181.0):
        with pytest.raises(InvalidScan, match="gravity_error_deg"):
            Scan(np.zeros((1, 3)), gravity=-Z, gravity_error_deg=error)


def test_from_the_air_the_ground_counts_and_not_the_roofs() -> None:
    rng = np.random.default_rng(0)
    roofs, sides = [], np.radians(42.0)
    for x, y in rng.uniform(-18, 18, (12, 2)):
        across, along = rng.uniform(-4, 4, 1500), rng.uniform(-6, 6, 1500)
        height = -11.0 - np.abs(across) * np.tan(sides)
        roofs.append(np.column_stack([x + along, y + across, height]))  # ridges side by side
    angle, distance = rng.uniform(0, 2 * np.pi, 40_000), rng.uniform(21, 45, 40_000)
    ground = [distance * np.cos(angle), distance * np.sin(angle), np.full(40_000, -20.0)]
    points = np.concatenate([*roofs, np.column_stack(ground)]).astype(np.float32)
    R = turn(rng, 8.0)
    assert angle_deg(estimate(turned(points, R)).up, R @ Z) < 2.0
