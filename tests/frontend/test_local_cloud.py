"""Local clouds, gathered at once or scan by scan."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from samples.lattice import gathered
from samples.on_board import BODY, beside, masted, with_mast

from segloc import ConfigError, InvalidScan, LocalCloud, RollingCloud, Scan, geometry
from segloc.frontend.local_cloud import Accumulator, LocalCloudConfig
from segloc.frontend.segmentation import Segmenter
from segloc.tools.batch.run import RecordedWindows
from segloc.types import Float32, Float64, Pose

CONFIG = LocalCloudConfig(radius_m=20.0, window_m=10.0)
PLACES = ((0.0, 0.0, 0.0), (4.5e5, 5.4e6, 310.0), (-30.0, -7e7, 2.0))


def scan_at(T: Pose, seed: int, count: int = 1500) -> Scan:
    """Something all round a sensor, some of it out of reach."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 1, (count, 3)) * rng.choice([0.3, 5.0, 20.0], (count, 1))
    return Scan(points.astype(np.float32), stamp=float(seed), T_odom_sensor=T)


def path(count: int, place: tuple[float, ...] = PLACES[0], step: float = 1.0) -> list[Pose]:
    poses = []
    for k in range(count):
        turn = geometry.yaw_transform(0.3 * k, (step * k, 0.1 * step * k, 0.0))
        tilt = geometry.upright(np.array([0.1 * np.sin(k), 0.05, 1.0]))
        T = turn @ tilt
        T[:3, 3] += place
        poses.append(T)
    return poses


def assert_same(one: LocalCloud, other: LocalCloud) -> None:
    assert one.points.tobytes() == other.points.tobytes()
    assert one.T_local_sensor.tobytes() == other.T_local_sensor.tobytes()
    assert (one.num_scans, one.stamp, one.voxel_size) == (
        other.num_scans,
        other.stamp,
        other.voxel_size,
    )


def made_at_once(scans: list[Scan], poses: Float64, reference: int = -1) -> LocalCloud:
    fresh = RollingCloud(CONFIG, min_step_m=0.0)
    for scan, T in zip(scans, poses, strict=True):
        fresh.add(scan, T)
    assert len(fresh) == len(scans)
    return fresh.cloud(reference)


@pytest.mark.parametrize("place", PLACES[:2])
def test_a_cloud_is_that_of_the_held_scans_gathered_at_once(place: tuple[float, ...]) -> None:
    rolling = RollingCloud(CONFIG)
    scans = [scan_at(T, k) for k, T in enumerate(path(40, place))]
    for k, scan in enumerate(scans):
        assert rolling.add(scan) == k
        if k % 13 != 12:
            continue
        held = [scans[i] for i in rolling.numbers]
        assert len(held) == 10 and held[-1] is scan  # steps of about a metre
        for reference in (-1, 0, 4):
            cloud = rolling.cloud(reference)
            points = [each.points for each in held]
            expected = gathered(points, list(rolling.poses), reference, CONFIG, 0.2)
            assert np.array_equal(cloud.points, expected)
            assert cloud.stamp == held[reference].stamp
            assert_same(cloud, made_at_once(held, rolling.poses, reference))


def test_it_shows_what_gathering_shows_and_is_not_thinned_again() -> None:
    poses = path(8)
    scans = [scan_at(T, k) for k, T in enumerate(poses)]
    rolling = RollingCloud(CONFIG)
    for scan in scans:
        rolling.add(scan)
    cloud, anew = rolling.cloud(), Accumulator(CONFIG).gather(scans)
    assert np.array_equal(cloud.T_local_sensor, anew.T_local_sensor)
    assert (cloud.num_scans, cloud.stamp, cloud.attitude) == (8, 7.0, "given")
    thinned = {tuple(c) for c in np.floor(anew.points / 0.5).astype(int)}
    rolled = {tuple(c) for c in np.floor(cloud.points / 0.5).astype(int)}
    assert len(thinned & rolled) > 0.9 * len(thinned | rolled)
    scene = Segmenter().segment(cloud)
    assert {tuple(p) for p in scene.structure} <= {tuple(p) for p in cloud.points}


def test_one_scan_is_the_scan_itself() -> None:
    T = path(2)[1]
    rolling = RollingCloud(CONFIG)
    points = scan_at(T, 0).points
    rolling.add(points, T)
    alone = rolling.cloud()
    assert_same(alone, Accumulator(CONFIG).gather(Scan(points, T_odom_sensor=T)))
    assert alone.num_scans == 1 and alone.voxel_size is None


def test_corrected_poses_are_as_if_scans_had_been_added_there() -> None:
    poses = path(30)
    scans = [scan_at(T, k) for k, T in enumerate(poses)]
    rolling = RollingCloud(CONFIG)
    for scan in scans:
        rolling.add(scan)
    drift = geometry.yaw_transform(0.02, (0.4, -0.3, 0.05))
    better = {k: drift @ T for k, T in enumerate(poses) if k % 3}
    rolling.correct(better)
    for k, T in zip(rolling.numbers, rolling.poses, strict=True):
        assert np.array_equal(T, better.get(k, poses[k]))
    held = [scans[k] for k in rolling.numbers]
    assert_same(rolling.cloud(), made_at_once(held, rolling.poses))
    before = rolling.cloud()
    for wrong in (
        {29: np.zeros((4, 4))},
        {28: drift @ poses[28], 29: geometry.yaw_transform(0, (5e7, 0, 0))},
    ):
        with pytest.raises(InvalidScan):
            rolling.correct(wrong)
        assert_same(rolling.cloud(), before)
    # Into another frame altogether: nothing of the window is lost.
    T_map_odom = geometry.yaw_transform(1.0, (4.5e5, 5.4e6, 300.0))
    rolling.correct(
        {k: T_map_odom @ T for k, T in zip(rolling.numbers, rolling.poses, strict=True)}
    )
    assert len(rolling) == len(held)
    assert_same(rolling.cloud(), made_at_once(held, rolling.poses))


def test_what_leaves_the_window_is_forgotten() -> None:
    rolling = RollingCloud(CONFIG, min_step_m=0.0)
    for k, T in enumerate(path(25)):
        rolling.add(scan_at(T, k))
    assert rolling.numbers == tuple(range(15, 25))
    memory = rolling.nbytes
    far = geometry.yaw_transform(0.0, (60.0, 0.0, 0.0))
    for k, T in enumerate(path(60)):
        rolling.add(scan_at(far @ T, k))
    assert rolling.nbytes < 1.5 * memory
    rolling.add(scan_at(np.eye(4), 0))  # behind a gap
    assert len(rolling) == 1
    rolling.clear()
    assert len(rolling) == 0
    with pytest.raises(InvalidScan, match="no scan at position -1 of 0"):
        rolling.cloud()


def test_a_robot_that_stands_holds_few_scans() -> None:
    rolling = RollingCloud(CONFIG)
    for k, T in enumerate(path(120, step=0.01)):
        rolling.add(scan_at(T, k, 50))
    assert len(rolling) < 20 and rolling.numbers[-1] == 119
    steps = np.linalg.norm(np.diff(rolling.poses[:-1, :3, 3], axis=0), axis=1)
    assert (steps >= 0.2).all()


@pytest.mark.parametrize("order", [(3, 8, 12, 14), (14, 3, 12, 8)])
def test_windows_of_a_recording_are_those_of_their_scans(order: tuple[int, ...]) -> None:
    scans = [scan_at(T, k) for k, T in enumerate(path(18))]
    reads: list[int] = []

    def read(i: int) -> Scan:
        reads.append(i)
        return scans[i]

    windows = RecordedWindows(read, CONFIG, 0.2, 10.0)
    for middle in order:
        span = range(max(0, middle - 3), middle + 3)
        chosen = scans[span.start : span.stop]
        poses = np.stack([scan.T_odom_sensor for scan in chosen])
        index = middle - span.start
        assert_same(windows.cloud(span, middle), made_at_once(chosen, poses, index))
    if order == tuple(sorted(order)):
        assert reads == sorted(set(reads))  # each is read once
    with pytest.raises(InvalidScan, match="T_odom_sensor"):
        RecordedWindows(lambda i: Scan(scans[i].points), CONFIG, 0.2, 10.0).cloud(range(2), 0)


def test_wrong_input_is_refused_and_changes_nothing() -> None:
    poses = path(6)
    rolling = RollingCloud(CONFIG)
    for k, T in enumerate(poses):
        rolling.add(scan_at(T, k))
    before = rolling.cloud()
    points = np.zeros((3, 3), np.float32)
    for scan, T, message in (
        (points, None, "T_odom_sensor"),
        (points, np.ones((4, 4)), "rigid"),
        (points, np.eye(3), r"\(4, 4\)"),
        (np.zeros((3, 2)), np.eye(4), r"\(N, 3\)"),
    ):
        with pytest.raises(InvalidScan, match=message):
            rolling.add(scan, T)
    assert_same(rolling.cloud(), before)
    with pytest.raises(InvalidScan, match="position 6 of 6"):
        rolling.cloud(6)
    for voxel_size, step in itertools.product((0.0, np.nan, 20.0), (0.2,)):
        with pytest.raises(ConfigError, match="voxel_size"):
            RollingCloud(CONFIG, voxel_size, min_step_m=step)
    with pytest.raises(ConfigError, match="min_step_m"):
        RollingCloud(CONFIG, min_step_m=-1.0)
    with pytest.raises(ConfigError, match="too small for this reach"):
        RollingCloud(LocalCloudConfig(radius_m=1000, window_m=9000), 0.01)
    with pytest.raises(InvalidScan, match="voxel_size must be positive"):
        LocalCloud(points, np.eye(4), voxel_size=0.0)


def test_threads_take_turns() -> None:
    rolling = RollingCloud(CONFIG)
    scans = [scan_at(T, k) for k, T in enumerate(path(30))]

    def clouds(count: int) -> list[int]:
        return [rolling.cloud().num_scans for _ in range(count)]

    rolling.add(scans[0])
    with ThreadPoolExecutor(2) as pool:
        read = pool.submit(clouds, 30)
        for scan in scans[1:]:
            rolling.add(scan)
        assert all(1 <= n <= 11 for n in read.result())
    held = [scans[k] for k in rolling.numbers]
    assert_same(rolling.cloud(), made_at_once(held, rolling.poses))


def cropped(points: Float32, T: Pose, radius: float) -> Float32:
    """Reference: points through T, of those the ones near the z axis."""
    moved = geometry.transform(T, points)
    near = (np.hypot(moved[:, 0], moved[:, 1]) < radius) & (np.abs(moved[:, 2]) < radius)
    return moved[near].astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_points_near_the_sensor_in_the_local_frame(count: int) -> None:
    rng = np.random.default_rng(count)
    accumulator = Accumulator(LocalCloudConfig(radius_m=20.0))
    scans = [
        Scan(rng.normal(0, 15, (count, 3)), T_odom_sensor=geometry.yaw_transform(*place))
        for place in ((0.3, (1.0, 2.0, 0.5)), (-2.0, (4.0, -3.0, 1.0)))
    ]
    cloud = accumulator.gather(scans)
    T_local_odom = geometry.inverse(geometry.levelled(scans[-1].T_odom_sensor))
    expected = [cropped(s.points, T_local_odom @ s.T_odom_sensor, 20.0) for s in scans]
    assert np.array_equal(cloud.points, np.concatenate(expected))
    assert cloud.points.dtype == np.float32


def far_scan(T: Pose, seed: int) -> Scan:
    """A scan without points near the sensor."""
    scan = scan_at(T, seed)
    return Scan(beside(scan.points), stamp=scan.stamp, T_odom_sensor=T)


def test_points_on_the_robot_are_in_no_cloud() -> None:
    config = CONFIG.model_copy(update={"body": BODY})
    clean = [far_scan(T, k) for k, T in enumerate(path(6))]
    seen = [masted(scan, k) for k, scan in enumerate(clean)]
    before = [scan.points.copy() for scan in seen]
    for scans, others in ((seen[-1], clean[-1]), (seen, clean)):
        assert_same(Accumulator(config).gather(scans), Accumulator(CONFIG).gather(others))
    alone = Scan(seen[0].points), Scan(clean[0].points)
    assert_same(Accumulator(config).gather(alone[0]), Accumulator(CONFIG).gather(alone[1]))
    rolling, expected = RollingCloud(config), RollingCloud(CONFIG)
    for scan, other in zip(seen, clean, strict=True):
        rolling.add(scan)
        expected.add(other)
        assert_same(rolling.cloud(), expected.cloud())
    assert_same(
        RecordedWindows(seen.__getitem__, config, 0.2, 10.0).cloud(range(1, 5), 3),
        RecordedWindows(clean.__getitem__, CONFIG, 0.2, 10.0).cloud(range(1, 5), 3),
    )
    assert all(map(np.array_equal, before, (scan.points for scan in seen)))


def test_times_stay_with_the_points_beside_the_robot() -> None:
    clean = far_scan(np.eye(4), 0).points
    points = np.concatenate([[[np.nan] * 3], with_mast(clean)])
    scan = Scan(points, times=np.arange(len(points)) * 1e-5)
    rest = LocalCloudConfig(body=BODY).without_body(scan)
    assert np.array_equal(rest.points, clean)
    assert rest.times is not None and rest.kept is not None
    assert np.array_equal(rest.times, np.arange(1, 1 + len(clean)) * 1e-5)
    assert np.array_equal(points[rest.kept], clean)
    everything = LocalCloudConfig(body=((-99.0,) * 3, (99.0,) * 3))
    assert len(Accumulator(everything).gather(scan).points) == 0


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ([[0.5, -1, -1], [-0.5, 1, 1]], "each minimum below its maximum"),
        ([[-1, -1, 0], [1, 1, 0]], "each minimum below its maximum"),
        ([[-1200, -500, -300], [200, 500, 300]], "body"),  # millimetres
        ([[float("nan"), 0, 0], [1, 1, 1]], "body"),
        ([[-1, -1], [1, 1]], "body"),
        ([-1, -1, -1, 1, 1, 1], "body"),
    ],
)
def test_boxes_of_no_robot_are_refused(body: object, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        LocalCloudConfig.model_validate({"body": body})
