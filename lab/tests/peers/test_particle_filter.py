"""The particle filter that is followed beside segloc: on a grid as Nav2 has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from segloc_lab.peers.particle_filter import Grid, ParticleFilter, Settings, needed, planar

from segloc import geometry
from segloc.tools.export.nav2 import FREE, OCCUPIED, GridOptions

EDGE_M = 0.1
SETTINGS = Settings()
STEP = (0.25, 0.0, np.radians(3.0))


@pytest.fixture
def room(tmp_path: Path) -> Grid:
    """A hall of 20 by 12 m with a recess and two posts, its corner at x -4, y 3."""
    cells = np.full((120, 200), FREE, np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = (OCCUPIED,) * 4
    cells[:40, 120:], cells[70:74, 50:54], cells[90:100, 150:152] = (OCCUPIED,) * 3
    image = b"P5\n200 120\n255\n" + cells[::-1].tobytes()
    (tmp_path / "map.pgm").write_bytes(image)
    (tmp_path / "map.yaml").write_text(
        f"image: map.pgm\nmode: trinary\nresolution: {EDGE_M}\norigin: [-4.0, 3.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return Grid.load(tmp_path / "map.yaml", SETTINGS.reach_m)


def seen(room: Grid, pose: np.ndarray) -> np.ndarray:
    """What stands, and the ground, as points in the frame of a sensor a metre above ground."""
    rows, columns = np.nonzero(room.distance == 0.0)
    xy = room.corner + EDGE_M * (np.column_stack([columns, rows]) + 0.5)
    stands = [np.column_stack([xy, np.full(len(xy), z)]) for z in (-0.5, 0.0, 1.5)]
    turns = np.linspace(0, 2 * np.pi, 200)
    ground = pose[:3, 3] + np.column_stack([np.cos(turns), np.sin(turns), np.full(200, -1.0)])
    points = np.concatenate([*stands, np.repeat(ground, 20, axis=0)])
    return geometry.transform(geometry.inverse(pose), points)


def test_a_planar_scan_is_what_stands_nearest(room: Grid) -> None:
    beams = planar(seen(room, geometry.yaw_transform(0.5, (2.0, 8.0, 0.0))), GridOptions(), 100.0)
    assert 300 < len(beams) <= 360
    ahead = beams[np.abs(np.arctan2(beams[:, 1], beams[:, 0])) < 0.02]
    assert len(ahead) and np.hypot(*ahead.T).max() < 14.0


def drive(
    room: Grid, followed: ParticleFilter, steps: int, pose: np.ndarray
) -> list[tuple[float, float, float]]:
    """Return errors of position and heading, and agreement, of a robot that goes in a circle."""
    found = []
    for _ in range(steps):
        pose = pose @ geometry.yaw_transform(STEP[2], (STEP[0], 0.0, 0.0))
        followed.update(STEP, planar(seen(room, pose), GridOptions(), 100.0))
        (x, y, yaw), agreed = followed.estimate()
        off = abs((yaw - geometry.heading(pose) + np.pi) % (2 * np.pi) - np.pi)
        found.append((float(np.hypot(x - pose[0, 3], y - pose[1, 3])), float(off), agreed))
    return found


@pytest.mark.slow
def test_a_robot_is_followed_from_a_given_pose(room: Grid) -> None:
    followed = ParticleFilter(room, SETTINGS, 1)
    followed.start((2.4, 6.2, 0.1), 0.5, 0.1)
    found = np.array(drive(room, followed, 60, geometry.yaw_transform(0.0, (2.0, 6.0, 0.0))))
    assert found[10:, 0].max() < 0.3 and found[10:, 1].max() < np.radians(5.0)
    assert found[10:, 2].mean() > 0.9
    assert len(followed.particles) < SETTINGS.most / 2  # few are needed once it is sure


@pytest.mark.slow
def test_a_robot_that_was_moved_is_found_by_poses_drawn_at_random(room: Grid) -> None:
    followed = ParticleFilter(room, SETTINGS, 1)
    followed.start((2.0, 6.0, 0.0), 0.5, 0.1)
    drive(room, followed, 20, geometry.yaw_transform(0.0, (2.0, 6.0, 0.0)))
    found = np.array(drive(room, followed, 120, geometry.yaw_transform(2.0, (5.0, 11.0, 0.0))))
    assert found[0, 0] > 2.0  # it does not know yet
    assert found[-1, 0] < 0.5 and found[-1, 1] < np.radians(10.0)


def test_more_bins_need_more_particles() -> None:
    counts = needed(np.array([1, 2, 10, 100]), SETTINGS)
    assert (np.diff(counts) > 0).all()
    # The chi-square quantile of 99 degrees of freedom at 99 %, over twice the error.
    assert counts[3] == pytest.approx(134.6 / (2 * SETTINGS.kld_error), rel=0.01)
