"""The peers that segloc is compared with: a comparison is worth what its rivals are."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from segloc_lab.calibration.worlds import simulated
from segloc_lab.peers import branch_and_bound, contour_context, segloc_query
from segloc_lab.peers.compare import close, confidence, overview, score, scored, table
from segloc_lab.peers.exchange import ELSEWHERE, Answers, Clouds, Gathering
from segloc_lab.peers.export import export
from segloc_lab.peers.scan_context import ScanContexts, sideways
from segloc_lab.peers.sets import CloudParts, Group, Material, Set, far
from segloc_lab.recordings import posed

from segloc import geometry
from segloc.tools.batch import query_positions
from segloc.tools.cli import app

SEARCH = branch_and_bound.Settings()
NAMES = ("segloc", "published")


def street(seed: int) -> NDArray[np.float32]:
    """A flat piece of ground with posts of random height on it."""
    rng = np.random.default_rng(seed)
    ground = np.c_[rng.uniform(-60, 60, (4000, 2)), np.full(4000, -1.7)]
    posts = [
        np.c_[rng.normal(at, 0.2, (40, 2)), rng.uniform(-1.7, rng.uniform(1, 8), 40)]
        for at in rng.uniform(-50, 50, (60, 2))
    ]
    return np.concatenate([ground, *posts]).astype(np.float32)


def places() -> Clouds:
    found = Gathering()
    for seed in range(4):
        found.add(street(seed), geometry.yaw_transform(seed, (100.0 * seed, 0.0, 0.0)))
    return found.clouds()


@pytest.mark.parametrize("degrees", [0, 30, 90, 180, -78])
def test_scan_context_finds_place_and_turn(degrees: float) -> None:
    views = places()
    turned = geometry.yaw_transform(np.radians(degrees), (0.0, 0.0, 0.0))
    query = geometry.transform(turned, views[2]).astype(np.float32)
    best = ScanContexts(views, 80.0).candidates(query, sideways([0.0]), 3)[0]
    assert best.view == 2
    np.testing.assert_allclose(
        best.T_map_query, views.poses[2] @ geometry.inverse(turned), atol=1e-6
    )


def test_shifted_scan_context_undoes_a_step_aside() -> None:
    views = places()
    aside = geometry.yaw_transform(0.0, (0.0, 10.0, 0.0))
    query = geometry.transform(geometry.inverse(aside), views[1]).astype(np.float32)
    best = ScanContexts(views, 80.0).candidates(query, sideways([-10.0, 0.0, 10.0]), 1)[0]
    assert best.view == 1
    np.testing.assert_allclose(best.T_map_query, views.poses[1] @ aside, atol=1e-6)


@pytest.mark.slow
def test_contour_context_finds_places_that_are_revisited(tmp_path: Path) -> None:
    """Another drive, with cars and a tenth of the objects replaced, and a drive elsewhere."""
    worlds = [simulated("town", seed, length_m=70.0) for seed in (8, 9)]
    groups = []
    for world, name in zip(worlds, ("all", ELSEWHERE), strict=True):
        drive = world.queries["hdl64e"]
        at = query_positions(drive.truth, 20.0, 10.0)
        truths = drive.truth[at] if name == "all" else far(drive.truth[at])
        groups.append(Group(drive, at, truths, name))
    export(tmp_path, Set(lambda _: Material(worlds[0].mapped, groups)), tmp_path, 1)
    settings = contour_context.Settings()
    options = Namespace(
        views="scan",
        cell=settings.cell_m,
        reach=settings.reach_m,
        levels=list(settings.levels_m),
        top=3,
        every=1,
        folders=[],
    )
    contour_context.answer(tmp_path, options)
    queries = Clouds.load(tmp_path / "queries.npz")
    for name, errors in (("contour_context", (0.5, 2.0)), ("contour_context-alone", (2.0, 5.0))):
        answers = Answers.load(tmp_path / f"answers-{name}.npz")
        right = close(answers.poses, queries.poses, *errors)
        assert right[queries.within_coverage].all(), name
        assert answers.scores[right].min() > answers.scores[queries.group == ELSEWHERE].max()
        assert (answers.ms > 0).all() and (answers.wall_ms > 0).all()


def walls(seed: int) -> NDArray[np.float32]:
    """Walls around a place at random, and flat ground."""
    rng = np.random.default_rng(seed)
    ground = np.c_[rng.uniform(-40, 40, (3000, 2)), np.full(3000, -1.7)]
    faces = []
    for _ in range(25):
        along, turn = rng.uniform(0, rng.uniform(4, 15), 400), rng.uniform(0, np.pi)
        line = rng.uniform(-35, 35, 2) + along[:, None] * (np.cos(turn), np.sin(turn))
        faces.append(np.c_[line, rng.uniform(-1.7, 3, 400)])
    return np.concatenate([ground, *faces]).astype(np.float32)


def walled(folder: Path) -> Path:
    """A protocol: three places, and one query in each of two, moved and turned."""
    views, queries = Gathering(), Gathering()
    for seed in range(3):
        T = geometry.yaw_transform(seed, (100.0 * seed, 0.0, 2.0))
        views.add(walls(seed), T)
        if seed:
            moved = geometry.yaw_transform(2.0 * seed, (4.0, -3.0 * seed, 0.0))
            queries.add(geometry.transform(geometry.inverse(moved), walls(seed)), T @ moved)
    folder.mkdir(parents=True)
    views.clouds().save(folder / "views-scan.npz")
    queries.clouds().save(folder / "queries.npz")
    np.save(folder / "path.npy", views.clouds().poses)
    return folder


def test_branch_and_bound_finds_the_pose(tmp_path: Path) -> None:
    folder = walled(tmp_path / "walls")
    queries, grid = (
        Clouds.load(folder / "queries.npz"),
        branch_and_bound.grid_of(Clouds.load(folder / "views-scan.npz"), SEARCH),
    )
    for q in range(len(queries)):
        share, x, y, yaw = grid.search(SEARCH.slice(queries[q]))[0]
        off = geometry.inverse(queries.poses[q]) @ geometry.yaw_transform(
            yaw, (x, y, queries.poses[q][2, 3])
        )
        assert share > 0.6 and np.hypot(*off[:2, 3]) < 0.8
        assert abs(np.degrees(geometry.heading(off))) < 2


def test_branch_and_bound_finds_nothing_without_points_at_sensor_height(tmp_path: Path) -> None:
    views = Clouds.load(walled(tmp_path / "walls") / "views-scan.npz")
    ground = views[0][views[0][:, 2] < SEARCH.low_m]
    assert branch_and_bound.grid_of(views, SEARCH).search(SEARCH.slice(ground)) == []


def test_branch_and_bound_finds_what_a_full_search_finds() -> None:
    """Bounds drop no window that holds the best pose."""
    rng = np.random.default_rng(5)
    small = replace(SEARCH, radius_m=10.0, top=1)
    grid = branch_and_bound.Grid(rng.uniform(0, 30, (500, 2)), small)
    xy = rng.uniform(-8, 8, (40, 2))
    turns = branch_and_bound.turned(xy, small)
    level, margin = grid.levels[0], grid.margin
    best = 0.0
    for cells in turns:
        for i in range(grid.shape[0]):
            for j in range(grid.shape[1]):
                at = cells + (i + margin, j + margin)
                best = max(best, float(level[at[:, 0], at[:, 1]].mean()))
    assert grid.search(xy)[0][0] >= best


def test_a_peer_resumes_and_its_answers_are_tabled(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verbs: None
) -> None:
    def evaluate(*more: str) -> str:
        given = ("--sets", "town", "--peers", "branch-and-bound,open3d", "--out", str(tmp_path))
        app(["evaluate", "peers", *given, *more], standalone_mode=False)
        return capsys.readouterr().out

    folder = walled(tmp_path / "town")
    nothing = tmp_path / "python"
    nothing.write_text("#!/bin/sh\nexit 1\n")
    nothing.chmod(0o755)
    printed = evaluate("--python", f"open3d={nothing}")
    # Nothing is wrong at the other place: the lowest right score there is the threshold.
    assert (
        "| 2D branch and bound in NumPy, GICP, overlap | 2 | 1 of 2 | 1 of 2 | 1 of 2 "
        "| 0 of 2 (< 65.8 %) |" in printed
    )
    assert "| Open3D FPFH, RANSAC, ICP | not installed |" in printed
    answers = folder / "answers-branch_and_bound.npz"
    written = answers.stat().st_mtime_ns
    evaluate("--python", f"open3d={nothing}")
    assert answers.stat().st_mtime_ns == written


def test_open3d_finds_the_pose(tmp_path: Path) -> None:
    open3d_query = pytest.importorskip("segloc_lab.peers.open3d_query", exc_type=ImportError)
    folder = walled(tmp_path / "walls")
    options = Namespace(views="scan", voxel=1.0, whole=1, apart=20.0, top=3, every=1)
    open3d_query.answer(folder, options)
    queries, answers = (
        Clouds.load(folder / "queries.npz"),
        Answers.load(folder / "answers-open3d.npz"),
    )
    assert close(answers.poses, queries.poses, 0.5, 2.0).all()


@pytest.mark.parametrize("traits", [(), ("cloud",)])
def test_a_set_is_exported_and_answered_by_segloc_and_as_published(
    tmp_path: Path, traits: tuple[str, ...]
) -> None:
    world = simulated("town", 8, length_m=40.0)
    drive = world.queries["hdl64e"]
    at = query_positions(drive.truth, 15.0, 10.0)
    here = Group(drive, at, drive.truth[at])
    there = replace(here, truths=far(here.truths), name=ELSEWHERE)
    made = Set(lambda _: Material(world.mapped, [here, there]), traits=traits)
    export(tmp_path, made, tmp_path, 1)
    queries = Clouds.load(tmp_path / "queries.npz")
    assert queries.within_coverage.tolist() == [True] * len(at) + [False] * len(at)
    options = Namespace(
        method="dsm", views=["long"], segments_alone=False, published=True, every=2, folders=[]
    )
    segloc_query.answer(tmp_path, options)
    ours, published = (Answers.load(tmp_path / f"answers-{name}-dsm.npz") for name in NAMES)
    asked = np.flatnonzero(ours.queried & queries.within_coverage)
    assert ours.accepted[asked].all() and published.queried[asked].all()
    for answers in (ours, published):
        assert close(answers.poses[asked], queries.poses[asked], 0.5, 2.0).all()
    assert not close(ours.poses, queries.poses, 3.0, 5.0)[~queries.within_coverage].any()


def test_the_parts_of_a_finished_cloud_are_all_of_it() -> None:
    cloud = walls(3).astype(np.float64)
    poses = [geometry.yaw_transform(turn, (20.0 * turn, 0.0, 1.0)) for turn in (0.0, 1.0)]
    parts = CloudParts("walls", cloud, np.stack(poses))
    assert min(len(parts.scan(i).points) for i in range(2)) > 0
    joined = np.concatenate(list(posed(parts)))
    assert len(joined) == len(cloud)
    assert cKDTree(joined).query(cloud)[0].max() < 1e-4


def answered(folder: Path, wrong: list[bool], scores: list[float]) -> Clouds:
    """Answers of a peer to a query at each of four places 100 m apart."""
    queries = places()
    answers = Answers(len(queries))
    for q, (off, value) in enumerate(zip(wrong, scores, strict=True)):
        T = queries.poses[q].copy()
        T[0, 3] += 4.0 if off else 1.0
        answers.give(q, T, value)
        answers.save(folder, "peer", q)
    queries.save(folder / "queries.npz")
    np.save(folder / "path.npy", queries.poses)
    return queries


def test_a_threshold_is_chosen_at_other_places(tmp_path: Path) -> None:
    queries = answered(tmp_path, [False, True, False, True], [0.9, 0.6, 0.5, 0.8])
    result = score(tmp_path / "answers-peer.npz", queries)
    assert result.right.tolist() == [[False] * 4, *[[True, False, True, False]] * 2]
    # Chosen without the place itself: 0.8, 0.85, 0.85, and 0.75 at the last, halfway to 0.9.
    assert result.taken.tolist() == [True, False, False, True]
    (row,) = table(scored(tmp_path)).rows
    assert row[:5] == ("peer", 4, "0 of 4", "1 of 4", "1 of 4")
    assert row[5] == "1 of 4 (< 69.9 %)" and row[6] == "0 of 0"
    assert overview([scored(tmp_path)]).rows == [("peer", "1 of 4, 1 false, 0 ms")]


def test_confidence_is_rated_over_all_thresholds(tmp_path: Path) -> None:
    queries = answered(tmp_path, [False, True, False, False], [0.9, 0.6, 0.5, 0.7])
    f1, auc = confidence(score(tmp_path / "answers-peer.npz", queries), np.ones(4, dtype=bool))
    assert f1 == pytest.approx(3 / 4)  # all accepted; the best two have recall 1/2
    assert auc == pytest.approx(0.25 * (1 + 1 + 3 / 4))


def test_answers_are_of_their_points_and_maps(tmp_path: Path) -> None:
    def clouds(x: float) -> Clouds:
        points = np.full((6, 3), x, np.float32)
        ends = np.array([0, 3, 6])
        known = np.ones(2, bool)
        return Clouds(
            np.tile(np.eye(4), (2, 1, 1)), np.ones(2, int), known, np.array(["a"] * 2), points, ends
        )

    def queried(queries: Clouds) -> list[bool]:
        return Answers.resume(tmp_path, "x", queries, "settings").queried.tolist()

    Answers.resume(tmp_path, "x", clouds(0.0), "settings").save(tmp_path, "x", 0)
    assert queried(clouds(0.0)) == [True, False]
    assert queried(clouds(9.0)) == [False, False]
    np.savez(tmp_path / "views-scan.npz", points=np.ones(3))
    assert queried(clouds(0.0)) == [False, False]
