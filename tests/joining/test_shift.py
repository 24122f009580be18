"""Sessions and maps that are off a map are refused before anything is written."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from samples.maps import town
from samples.plaza import Plaza, PlazaSequence
from samples.walk import as_folder, run

from segloc import SegmentMap, geometry
from segloc.joining.shift import measure_shift
from segloc.tiles import TiledMap, localizer_in, merge_into_tiles
from segloc.tools.io import Trajectory, write_tum
from segloc.types import Pose, Reposed

pytestmark = pytest.mark.slow

FRAMES = {
    "right": np.eye(4),
    "shifted": geometry.yaw_transform(0.0, (1.2, -1.6, 0.0)),
    "turned": geometry.yaw_transform(np.radians(3.0)),
}
"""Frames of the session's poses in that of the map."""
STOREY = geometry.yaw_transform(0.0, (0.1, 0.0, 3.2))
OFF = ("shifted", "turned")


def thin(seed: int) -> Plaza:
    return Plaza(seed).thinned(3)


def later(plaza: Plaza) -> PlazaSequence:
    """A walk beside the first one."""
    walk = PlazaSequence(plaza, steps=10)
    walk.poses[:, 1, 3] += 1.5
    return walk


def built(folder: Path, poses: str, out: Path) -> Path:
    assert run("map", "build", folder, "--poses", poses, "--method", "geo", "--out", out) == 0
    return out


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of a first walk, a later one with poses in three frames, and one elsewhere; maps."""
    root, plaza = tmp_path_factory.mktemp("shift"), thin(0)
    as_folder(root / "first", PlazaSequence(plaza, steps=12))
    walk = later(plaza)
    as_folder(root / "later", walk)
    for name, frame in {**FRAMES, "above": STOREY}.items():
        write_tum(root / "later" / f"{name}.tum", Trajectory(walk.indices, frame @ walk.poses))
        built(root / "later", f"{name}.tum", root / f"{name}.segmap")
    far = PlazaSequence(thin(5), steps=6)
    moved = geometry.yaw_transform(0.0, (300.0, 0.0, 0.0)) @ far.poses
    as_folder(root / "far", Reposed(far, moved))
    built(root / "first", "poses.tum", root / "site.segmap")
    return root


@pytest.fixture
def site(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of the first walk's map, in the working folder."""
    monkeypatch.chdir(tmp_path)
    site = Path("site.segmap")
    site.write_bytes((root / site).read_bytes())
    yield site


def contents(where: Path) -> dict[str, bytes]:
    files = where.iterdir() if where.is_dir() else [where]
    return {path.name: path.read_bytes() for path in files if not path.name.startswith(".")}


def worst_m(prior_map: SegmentMap | TiledMap) -> float:
    """Largest error of some queries [m]."""
    plaza, localizer = thin(0), localizer_in(prior_map)
    truth: list[Pose] = [geometry.yaw_transform(1.0 + k, (2.0 * k - 6, 2.0, 1.8)) for k in range(4)]
    answers = [localizer.localize(plaza.scan(T, seed=90 + k)) for k, T in enumerate(truth)]
    assert all(answer.localized for answer in answers)
    offs = [a.T_map_sensor[:3, 3] - T[:3, 3] for a, T in zip(answers, truth, strict=True)]
    return float(np.linalg.norm(offs, axis=1).max())


def test_an_update_of_a_map(root: Path, site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    update = ["map", "update", site, root / "later", "--out", site, "--poses"]
    before = contents(site)
    for name, expected in (("shifted", "2.00 m and 0.0 degrees"), ("turned", "3.0 degrees")):
        assert run(*update, f"{name}.tum") == 1
        error = capsys.readouterr().err
        assert expected in error and "--unchecked" in error
        assert contents(site) == before
    assert worst_m(SegmentMap.load(site)) < 0.3

    assert run(*update, "shifted.tum", "--unchecked") == 0
    assert contents(site) != before
    site.write_bytes(before[site.name])
    assert run(*update, "right.tum") == 0
    assert "off the map" in capsys.readouterr().out
    assert len(np.unique(SegmentMap.load(site).session)) == 2
    assert worst_m(SegmentMap.load(site)) < 0.3


def test_the_remedy_of_the_message_mends_it(
    root: Path, site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    update = ["map", "update", site, root / "later", "--out", "new.segmap", "--poses"]
    assert run(*update, "turned.tum") == 1
    program, *command = shlex.split(capsys.readouterr().err.split("`")[1])
    assert program == "segloc"
    assert run(*command) == 0
    aligned = Path(command[command.index("--out") + 1]).absolute()
    assert run(*update, aligned / "session_0.tum") == 0
    assert worst_m(SegmentMap.load("new.segmap")) < 0.3


def test_an_update_of_tiles(root: Path, site: Path) -> None:
    tiles = Path("tiles")
    assert run("map", "tile", site, "--size", 50, "--out", tiles) == 0
    update, before = ["map", "update", tiles, root / "later", "--out", tiles], contents(tiles)
    for name in OFF:
        assert run(*update, "--poses", f"{name}.tum") == 1
        assert contents(tiles) == before
    assert run("map", "merge", tiles, root / "shifted.segmap", "--out", tiles) == 1
    assert contents(tiles) == before
    assert worst_m(TiledMap(tiles)) < 0.3
    assert run(*update, "--poses", "right.tum") == 0
    assert run("map", "merge", tiles, root / "right.segmap", "--out", tiles) == 0
    assert worst_m(TiledMap(tiles)) < 0.3
    assert run(*update, "--poses", "shifted.tum", "--unchecked") == 0


def test_a_merge_and_a_build(root: Path, site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = Path("out.segmap")
    build = ["map", "build", root / "first", root / "later", "--poses", "poses.tum", "--poses"]
    for command in (
        ["map", "merge", site, root / "shifted.segmap", "--out", out],
        ["map", "merge", site, root / "turned.segmap", "--out", out],
        [*build, "shifted.tum", "--out", out],
    ):
        assert run(*command) == 1
        error = capsys.readouterr().err
        assert "`segloc align " in error and "--unchecked" in error
        assert not out.exists()
    assert run("map", "merge", site, root / "right.segmap", "--out", out) == 0
    assert worst_m(SegmentMap.load(out)) < 0.3
    assert run(*build, "right.tum", "--out", out) == 0
    assert run("map", "merge", site, root / "shifted.segmap", "--out", out, "--unchecked") == 0


def test_a_storey_that_looks_like_another_is_joined(
    root: Path, site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    merge = ["map", "merge", site, root / "above.segmap", "--out", "two.segmap"]
    assert run(*merge) == 1
    assert "--elsewhere" in capsys.readouterr().err
    assert run(*merge, "--elsewhere") == 0
    assert "look like those above or below in the map" in " ".join(capsys.readouterr().err.split())
    heights = SegmentMap.load("two.segmap").trajectory[:, 2, 3]
    assert np.ptp(heights) > 3.0


def test_a_session_elsewhere_is_noted(
    root: Path, site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    update = ["map", "update", site, root / "far", "--poses", "poses.tum", "--out", "new.segmap"]
    assert run(*update, "--elsewhere") == 0
    streams = capsys.readouterr()
    assert "0 of 6 places along it are localized" in " ".join(streams.err.split())
    assert "off the map" not in streams.out


def test_maps_whose_descriptors_are_not_at_hand_are_joined(tmp_path: Path) -> None:
    made = town()  # of weights that do not exist
    shift = measure_shift(made, made)
    assert not shift.is_known and "descriptors" in shift.remark
    made.save(tmp_path / "a.segmap")
    assert run("map", "tile", tmp_path / "a.segmap", "--size", 50, "--out", tmp_path / "tiles") == 0
    assert merge_into_tiles(tmp_path / "tiles", made).shift == shift
