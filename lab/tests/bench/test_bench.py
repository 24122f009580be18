"""Benchmarks: what they time is right, and what they report is complete."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.bench import (
    comparing,
    fps,
    geometric,
    growth,
    harness,
    inputs,
    network,
    query,
    stored,
    stream,
    suite,
)
from segloc_lab.bench.harness import in_process
from segloc_lab.padding import padded_with_copies
from segloc_lab.results.store import Result
from typer.testing import CliRunner

from segloc import Config, ConfigError, Scan, SeglocError, _native, build_map, geometry
from segloc.cli import app
from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS


@pytest.mark.parametrize("sampler", [fps.per_segment, fps.batched, fps.batched_columns])
def test_rival_samplers_take_the_farthest_points(sampler):
    points = inputs.segments(4)
    assert np.array_equal(sampler(points, 60), _native.fps(points, 60))
    assert fps.shortfall(points, sampler(points, 60)) > 0.999


def test_shortfall_sees_samples_that_are_too_near():
    points = inputs.segments(4)
    order = _native.fps(points, 60).copy()
    order[2, 30:] = order[2, 30:][::-1]
    assert fps.shortfall(points, order) < 0.999


def test_partitions_are_compared_up_to_names():
    assert geometric.same_partition(np.array([0, 0, 1]), np.array([5, 5, 2]))
    assert not geometric.same_partition(np.array([0, 0, 1]), np.array([0, 1, 1]))
    assert not geometric.same_partition(np.array([0, 0, 1]), np.array([0, 0, 0]))


def test_rival_neighbours_are_exact():
    database, queries = inputs.descriptors(500), inputs.descriptors(20, seed=1)
    expected, _ = _native.knn(queries, database, 7)
    assert np.array_equal(geometric.product_and_partition(queries, database, 7), expected)


def test_match_problems_are_what_they_say():
    problem = inputs.match_problem(inliers=0.02, mapped=1000)
    R, t = problem.T_map_local[:3, :3], problem.T_map_local[:3, 3]
    moved = problem.query[problem.match_query] @ R.T + t
    near = np.linalg.norm(moved - problem.mapped[problem.match_map], axis=1) < 1.0
    assert len(near) == 7500
    assert 140 <= near.sum() <= 160
    assert near[:3750].sum() > 1.5 * near[3750:].sum()
    assert problem.found(problem.T_map_local[None])
    assert not problem.found(np.eye(4)[None])
    assert problem.found(geometric.consensus(problem))
    assert problem.found(geometric.prosac(problem))


@pytest.mark.parametrize("layers", [DSM_LAYERS, ESM_LAYERS])
def test_random_networks_run(layers):
    engine = network.build(layers, network.random_tensors(layers))
    vectors, _ = engine.describe(network.prepared_segments(3), 1)
    assert np.isfinite(vectors).all()
    assert vectors.std(axis=0).max() > 0
    assert all(flops > 0 for flops in network.layer_flops(layers))


def test_interleaving_runs_each_in_turn():
    order = []
    runs = {name: lambda name=name: order.append(name) for name in "ab"}
    times = harness.interleaved(runs, 1, 3)
    assert order == list("ab") * 4  # one round to warm up
    assert set(times) == set("ab")


@pytest.fixture(scope="module")
def plaza_scene():
    walk = inputs.PlazaWalk(inputs.Plaza(), steps=6)
    return query._scene(build_map(walk, Config(threads=1)), walk, walk, [2, 3])


@pytest.fixture(scope="module")
def plaza_stream():
    walk = inputs.PlazaWalk(inputs.Plaza(), steps=22)
    scans = [walk.scan(i) for i in range(len(walk))]
    return stream.Stream(build_map(walk, Config(threads=1)), scans, walk.poses, 2)


@pytest.mark.slow
def test_a_padded_map_has_the_size_that_was_wanted_and_still_localizes(plaza_scene):
    size = 3 * len(plaza_scene.prior_map) + 7
    measured = query.query_row("query", plaza_scene, 1, 1, segments=size)
    assert measured.details["map segments"] == size
    assert measured.details["correct"] == 2
    assert {"segmentation, ms", "matching, ms", "verification, ms"} <= set(measured.details)


def test_padding_leaves_the_map_as_it_was(plaza_scene):
    prior_map = plaza_scene.prior_map
    count = len(prior_map)
    larger = padded_with_copies(prior_map, count + 500)
    assert (len(prior_map), len(larger)) == (count, count + 500)
    assert np.array_equal(np.sort(larger.centroids[:count], 0), np.sort(prior_map.centroids, 0))
    assert len(padded_with_copies(prior_map, 10)) == count


@pytest.mark.parametrize(
    ("names", "threads", "repeats"), [(["sorting"], [1], 1), (["fps"], [0], 1), (["fps"], [1], 0)]
)
def test_wrong_requests_are_refused(names, threads, repeats):
    with pytest.raises(ConfigError):
        suite.run(names, threads, repeats)


SMALLEST = {
    "fps": ((fps, "SEGMENTS", 10),),
    "network": ((network, "SEGMENTS", 12), (network, "CHUNKS", (5,))),
    "dsm_vs_esm": ((network, "SEGMENTS", 12),),
    "clustering": (),
    "knn": ((geometric, "DATABASE", 2000),),
    "pose": (),
    "icp": (),
    "query": ((query, "MAP_SEGMENTS", 3000), (query, "simulated_scene", None)),
    **dict.fromkeys(
        ("stream", "stream_os1_128", "stream_vlp16"),
        ((stream, "MAP_SEGMENTS", 3000), (stream, "simulated_stream", None)),
    ),
}
"""What makes each benchmark small."""


@pytest.mark.slow
@pytest.mark.parametrize("name", suite.BENCHMARKS)
def test_every_benchmark_runs_at_its_smallest(name, plaza_scene, plaza_stream, monkeypatch):
    """With PyTorch, ONNX Runtime and the other rivals where they are installed."""
    for module, constant, value in SMALLEST[name]:
        made = plaza_stream if module is stream else plaza_scene
        small = (lambda *_, made=made: made) if value is None else value
        monkeypatch.setattr(module, constant, small)
    monkeypatch.setattr(harness, "_SGEMM_SIZE", 64)
    row = suite.BENCHMARKS[name](1, 1)
    assert row.ours_ms > 0 and all(ms > 0 for ms in row.rivals.values())
    if name == "network" and harness.optional("torch") is not None:
        assert any("PyTorch" in rival for rival in row.rivals)
    json.dumps(row.as_json(), allow_nan=False)
    (kept,) = stored.stored([row], "segloc bench", "a machine")
    assert kept.name == ("streams" if name in stored.SENSORS else "bench")
    shown = [cell for cell in kept.rows[0] if isinstance(cell, float)]
    assert any(cell == pytest.approx(row.ours_ms, rel=1e-2) for cell in shown)


def test_a_query_on_real_scans_is_kept_stage_by_stage(plaza_scene) -> None:
    other = inputs.PlazaWalk(inputs.Plaza(seed=7), steps=2).scan(0)
    scene = replace(plaza_scene, elsewhere=[Scan(other.points)])
    row = query.query_row("profile 3000", scene, 1, 1, segments=3000, rivals=False)
    kept = stored.stored_queries([("profile", row)], "bench.kitti_query", "a machine")
    assert kept.rows[0][:3] == ("profile", 3000, 1) and kept.rows[0][-2] == "2 of 2"
    assert kept.rows[0][-3] == round(row.ours_ms, 1)
    assert row.details["elsewhere, ms"] > 0 and str(kept.rows[0][-1]).endswith("x)")
    with pytest.raises(SeglocError, match="another place"):
        known = replace(plaza_scene, elsewhere=[plaza_scene.queries[0][0]])
        query.query_row("profile 3000", known, 1, 1, segments=3000, rivals=False)


def test_maps_grow_and_the_true_pose_is_found() -> None:
    small, large = (in_process(1, growth.measured, size, 30, (), 1) for size in (2_000, 200_000))
    assert small.found and large.found
    assert large.neighbours > small.neighbours and large.map_mb > small.map_mb


def test_growth_asks_for_what_it_takes_out_of_maps(plaza_scene, tmp_path: Path) -> None:
    maps = (tmp_path / "a.segmap", tmp_path / "b.segmap")
    for path in maps:
        padded_with_copies(plaza_scene.prior_map, 1500).save(path)
    found = growth.measured(2_000, 30, maps, 1)
    assert found.source == "towns" and found.segments == 2_000
    problem = growth.of_towns(maps, 2_000, 30)
    assert problem is not None and len(problem.centroids) == 2_000
    asked = geometry.transform(problem.T_map_local, problem.query_centroids)
    assert np.linalg.norm(asked[:, None] - problem.centroids, axis=2).min() > 0
    assert growth.of_towns(maps, 10**6, 30) is None


def test_pytorch_runs_in_its_own_forms():
    pytest.importorskip("torch", reason="the training framework needs PyTorch")
    from segloc_lab.training import ops

    assert ops._is_native()
    with ops.torch_forms():
        assert not ops._is_native()
    assert ops._is_native()


@pytest.mark.slow
@pytest.mark.usefixtures("verbs")
def test_what_became_slower_is_said_by_the_clock_and_by_rivals() -> None:
    def day(ours: float, rival: float) -> list[harness.Row]:
        return [harness.Row("knn", 1, ours, {"faiss": rival}), harness.Row("pose", 1, ours)]

    for now, slower in (
        (day(2.0, 4.0), [False, False]),  # as before
        (day(4.0, 8.0), [False, True]),  # a slower machine, and nothing that tells
        (day(4.0, 4.0), [True, True]),
        (day(2.0, 1.0), [False, False]),  # faster rivals
    ):
        assert [c.is_slower for c in comparing.compared(day(2.0, 4.0), now)] == slower
    assert comparing.compared([], day(1.0, 1.0)) == []


@pytest.mark.parametrize("text", ["", "{}", '[{"name": "knn"}]', "\x00"])
def test_other_files_are_not_compared(tmp_path: Path, text: str) -> None:
    file = tmp_path / "old.json"
    file.write_text(text)
    with pytest.raises(SeglocError, match="--json writes"):
        comparing.read_json(file)


def test_the_command_line_writes_every_figure(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(geometric, "DATABASE", 2000)
    file = tmp_path / "bench.json"
    options = ["--only", "clustering,knn", "--threads", "1", "--repeats", "1", "--json", str(file)]
    options += ["--store", str(tmp_path / "results")]
    result = CliRunner().invoke(app, ["bench", *options], catch_exceptions=False)
    assert result.exit_code == 0
    rows = json.loads(file.read_text())
    assert [row["name"] for row in rows] == ["clustering", "knn"]
    for row in rows:
        assert row["threads"] == 1
        assert row["ours_ms"] > 0
        assert any("SciPy" in name for name in row["rivals"])
    assert rows[0]["bound_ms"] is None
    assert rows[1]["bound_ms"] > 0
    assert "SciPy" in result.stdout
    kept = Result.load(tmp_path / "results" / "bench.json")
    assert kept.command == "segloc bench --only clustering,knn --threads 1 --repeats 1"
    assert [cells[0] for cells in kept.rows] == ["`clustering`", "`knn`"]
    assert "SciPy" in str(kept.rows[0][3])
    options = ["--only", "knn", "--threads", "1", "--repeats", "1", "--compare", str(file)]
    result = CliRunner().invoke(app, ["bench", *options], catch_exceptions=False)
    assert result.exit_code == 0 and "slower" in result.stdout and "against rivals" in result.stdout
