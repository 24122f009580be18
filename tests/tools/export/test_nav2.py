"""Grids for Nav2, read as its map server reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from samples.on_board import with_mast

from segloc import Config, ConfigError, SegmentMap, build_map, geometry
from segloc.tools.export import export
from segloc.tools.export.formats import Options
from segloc.tools.export.nav2 import GridOptions
from segloc.types import Float64, Scan

UTM = np.array([500_000.0, 5_400_000.0, 100.0])


def hall() -> Float64:
    """20 x 10 m with its corner at the origin, and a box at (12, 5)."""
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform([0, 0], [20, 10], (60_000, 2)), np.zeros(60_000)])
    along, up = rng.uniform(0, 1, 20_000), rng.uniform(0, 2.5, 20_000)
    x, y = 20 * along, 10 * along
    walls = [np.column_stack([x, np.full_like(x, side), up]) for side in (0.0, 10.0)]
    walls += [np.column_stack([np.full_like(y, side), y, up]) for side in (0.0, 20.0)]
    box = rng.uniform([11.5, 4.5, 0.1], [12.5, 5.5, 1.5], (4000, 3))
    return np.concatenate([floor, *walls, box])


class Served:
    """A grid as nav2_map_server loads it: trinary mode, -1 unknown, 0 free, 100 occupied."""

    def __init__(self, folder: Path, name: str = "map") -> None:
        self.facts = yaml.safe_load((folder / f"{name}.yaml").read_text())
        data = (folder / self.facts["image"]).read_bytes()
        magic, size, most, pixels = data.split(b"\n", 3)
        width, height = map(int, size.split())
        assert (magic, most, len(pixels)) == (b"P5", b"255", width * height)
        shade = np.frombuffer(pixels, np.uint8).reshape(height, width)[::-1] / 255.0
        occupancy = shade if self.facts["negate"] else 1.0 - shade
        self.cells = np.full(shade.shape, -1)
        self.cells[occupancy > self.facts["occupied_thresh"]] = 100
        self.cells[occupancy < self.facts["free_thresh"]] = 0

    def at(self, x: float, y: float) -> int:
        """The cell at a position of AMCL's frame."""
        x0, y0, yaw = self.facts["origin"]
        assert yaw == 0.0
        edge = self.facts["resolution"]
        return int(self.cells[int((y - y0) / edge), int((x - x0) / edge)])


def check(served: Served, shift: Float64) -> None:
    def at(x: float, y: float) -> int:
        return served.at(x + shift[0], y + shift[1])

    assert at(12.0, 5.0) == 100
    assert at(0.1, 5.0) == 100
    assert at(10.0, 9.9) == 100
    assert at(4.0, 5.0) == 0
    assert at(17.0, 3.0) == 0
    assert (served.cells == -1).any()


def served(prior_map: SegmentMap, folder: Path, *grid: float) -> Served:
    prior_map.save(folder / "hall.segmap")
    export(folder / "hall.segmap", "nav2", folder / "nav", Options(grid=GridOptions(*grid)))
    return Served(folder / "nav")


@pytest.mark.parametrize("shift", [np.zeros(3), UTM])
def test_the_grid_of_a_cloud_fits_its_frame(tmp_path: Path, shift: Float64) -> None:
    prior_map = SegmentMap.from_cloud(hall() + shift, Config(threads=1))
    check(served(prior_map, tmp_path), shift)


def test_the_grid_of_scans_is_free_where_the_sensor_was(tmp_path: Path) -> None:
    poses = np.tile(np.eye(4), (9, 1, 1))
    poses[:, :3, 3] = [(2.0 + 2.0 * k, 5.0 if k < 4 else 2.5, 1.0) for k in range(9)]
    cloud = hall()
    follower = np.random.default_rng(1).uniform([3.9, 4.9, 0.1], [4.1, 5.1, 1.6], (300, 3))
    seen = [np.concatenate([cloud, follower]) - T[:3, 3] for T in poses]
    scans = [Scan(points, T_odom_sensor=T) for points, T in zip(seen, poses, strict=True)]
    grid = served(build_map(scans, Config(threads=1)), tmp_path, 0.1, 0.4, 1.8)
    check(grid, np.zeros(3))
    assert grid.at(4.0, 5.0) == 0


def test_a_slice_leaves_out_what_is_above_it(tmp_path: Path) -> None:
    prior_map = SegmentMap.from_cloud(hall(), Config(threads=1))
    grid = served(prior_map, tmp_path, 0.1, 1.8, 2.4)
    assert grid.at(0.1, 5.0) == 100
    assert grid.at(12.0, 5.0) != 100


def test_absurd_slices_are_refused() -> None:
    with pytest.raises(ConfigError, match="LOW below HIGH"):
        GridOptions(low_m=2.0, high_m=1.0)


def drive_in_hall(
    *at: tuple[float, float], cloud: Float64 | None = None, turn: float = 0.0
) -> SegmentMap:
    """A map of a drive through a hall; the sensor sees the robot, which turns at each pose."""
    cloud = hall() if cloud is None else cloud
    poses = [geometry.yaw_transform(turn * k, (*xy, 1.0)) for k, xy in enumerate(at)]
    seen = [with_mast(geometry.transform(geometry.inverse(T), cloud)) for T in poses]
    scans = [Scan(points, T_odom_sensor=T) for points, T in zip(seen, poses, strict=True)]
    return build_map(scans, Config(threads=1))


def test_what_a_robot_drove_over_is_free_by_its_width(tmp_path: Path) -> None:
    prior_map = drive_in_hall(*((2.0 + 1.5 * k, 5.0) for k in range(5)))
    lanes = {}
    for width in (0.0, 0.3, 1.2):
        (folder := tmp_path / f"{width}").mkdir()
        grid = served(prior_map, folder, 0.05, 0.4, 1.8, width)
        lane = [(x, y) for x in np.arange(2.0, 8.0, 0.1) for y in (5.0, 5.1, 4.75, 4.5)]
        lanes[width] = np.array([grid.at(x, y) for x, y in lane]).reshape(-1, 4)
        check(grid, np.zeros(3))
    assert all((lanes[0.0][:, k] == 100).any() for k in range(3))  # the mast, at each pose
    assert (lanes[0.3][:, :2] == 0).all() and (lanes[0.3][:, 2] == 100).any()
    assert (lanes[1.2] == 0).all()


def both_ways(prior_map: SegmentMap, folder: Path) -> list[Served]:
    """The grid without and with a lane."""
    for name in ("seen", "driven"):
        (folder / name).mkdir()
    widths = (("seen", 0.0), ("driven", 0.6))
    return [served(prior_map, folder / name, 0.05, 0.4, 1.8, width) for name, width in widths]


def test_a_lane_connects_poses_of_one_drive_and_no_others(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    up = rng.uniform([0.0, 0.0], [10.0, 2.5], (20_000, 2))
    cloud = np.concatenate([hall(), np.column_stack([np.full(len(up), 10.0), up])])
    legs = [(1.0 + k, 2.0) for k in range(7)] + [(13.0 + k, 2.0) for k in range(5)]
    seen, driven = both_ways(drive_in_hall(*legs, cloud=cloud), tmp_path)
    assert driven.at(5.5, 2.0) == driven.at(15.5, 2.0) == 0
    between = [[each.at(x, 2.0) for x in np.arange(8.0, 12.0, 0.05)] for each in (seen, driven)]
    assert between[0] == between[1] and 100 in between[1]  # the wall between two legs


def test_nobody_drove_to_viewpoints_in_a_finished_cloud(tmp_path: Path) -> None:
    prior_map = SegmentMap.from_cloud(hall(), Config(threads=1))
    assert len(prior_map.trajectory) > 1
    seen, driven = both_ways(prior_map, tmp_path)
    assert np.array_equal(seen.cells, driven.cells)


@pytest.mark.parametrize(("turn", "expected"), [(0.0, 0), (np.pi, 100)])
def test_nobody_knows_the_way_of_a_robot_that_turned(
    tmp_path: Path, turn: float, expected: int
) -> None:
    """The line between two poses passes the box."""
    prior_map = drive_in_hall((10.0, 5.0), (14.0, 5.0), turn=turn)
    assert served(prior_map, tmp_path, 0.05, 0.4, 1.8, 0.6).at(12.0, 5.0) == expected


@pytest.mark.parametrize("low", [-0.2, -9.8, -14.6])
def test_walls_at_the_border_of_a_compact_map_stay_there(tmp_path: Path, low: float) -> None:
    """Its points are the middles of voxels, which may be rounded to either side of a cell."""
    site = SegmentMap.empty("geo", "f", 5, cloud_voxel=0.4)
    x, y = (axis.ravel() for axis in np.meshgrid(low + 0.4 * np.arange(45), 0.4 * np.arange(45)))
    floor = np.column_stack([x, y, np.full_like(x, 0.2)])
    wall = np.array([(low, y, z) for y in 0.4 * np.arange(45) for z in (0.6, 1.0, 1.4)])
    site.add_cloud(np.vstack([floor, wall]))
    site.add_trajectory(geometry.yaw_transform(0, (low + 8.0, 8.0, 1.5))[None])
    site.save(tmp_path / "site.segmap")
    export(tmp_path / "site.segmap", "nav2", tmp_path / "grid")
    occupied = np.flatnonzero((Served(tmp_path / "grid").cells == 100).any(axis=0))
    assert occupied.size and occupied.max() < 20
