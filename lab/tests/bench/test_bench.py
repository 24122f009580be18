"""Benchmarks: what they time is right, and what they report is complete."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.bench import fps, geometric, harness, network, query, stream
from segloc_lab.bench import harness as rows
from segloc_lab.cli import bench as suite
from segloc_lab.padding import padded_with_copies
from typer.testing import CliRunner

from segloc import Config, ConfigError, Scan, SeglocError, _native, build_map
from segloc.cli import app
from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS


@pytest.mark.parametrize("sampler", [fps.per_segment, fps.batched, fps.batched_columns])
def test_rival_samplers_take_the_farthest_points(sampler):
    points = harness.segments(4)
    assert np.array_equal(sampler(points, 60), _native.fps(points, 60))
    assert fps.shortfall(points, sampler(points, 60)) > 0.999


def test_shortfall_sees_samples_that_are_too_near():
    points = harness.segments(4)
    order = _native.fps(points, 60).copy()
    order[2, 30:] = order[2, 30:][::-1]
    assert fps.shortfall(points, order) < 0.999


def test_partitions_are_compared_up_to_names():
    assert geometric.same_partition(np.array([0, 0, 1]), np.array([5, 5, 2]))
    assert not geometric.same_partition(np.array([0, 0, 1]), np.array([0, 1, 1]))
    assert not geometric.same_partition(np.array([0, 0, 1]), np.array([0, 0, 0]))


def test_rival_neighbours_are_exact():
    database, queries = harness.descriptors(500), harness.descriptors(20, seed=1)
    expected, _ = _native.knn(queries, database, 7)
    assert np.array_equal(geometric.product_and_partition(queries, database, 7), expected)


def test_match_problems_are_what_they_say():
    problem = harness.match_problem(inliers=0.02, mapped=1000)
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
    walk = harness.PlazaWalk(harness.Plaza(), steps=6)
    return query._scene(build_map(walk, Config(threads=1)), walk, walk, [2, 3])


@pytest.fixture(scope="module")
def plaza_stream():
    walk = harness.PlazaWalk(harness.Plaza(), steps=22)
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
    (table,) = rows.tables([row])
    shown = [cell for cell in table.rows[0] if isinstance(cell, float)]
    assert any(cell == pytest.approx(row.ours_ms, rel=1e-2) for cell in shown)


def test_a_query_on_real_scans_is_kept_stage_by_stage(plaza_scene) -> None:
    other = harness.PlazaWalk(harness.Plaza(seed=7), steps=2).scan(0)
    scene = replace(plaza_scene, elsewhere=[Scan(other.points)])
    row = query.query_row("profile 3000", scene, 1, 1, segments=3000, rivals=False)
    kept = rows.query_table([("profile", row)])
    assert kept.rows[0][:3] == ("profile", 3000, 1) and kept.rows[0][-2] == "2 of 2"
    assert kept.rows[0][-3] == round(row.ours_ms, 1)
    assert row.details["elsewhere, ms"] > 0 and str(kept.rows[0][-1]).endswith("x)")
    with pytest.raises(SeglocError, match="another place"):
        known = replace(plaza_scene, elsewhere=[plaza_scene.queries[0][0]])
        query.query_row("profile 3000", known, 1, 1, segments=3000, rivals=False)


def test_pytorch_runs_in_its_own_forms():
    pytest.importorskip("torch", reason="the training framework needs PyTorch")
    from segloc_lab.training import models as ops

    assert ops._is_native()
    with ops.torch_forms():
        assert not ops._is_native()
    assert ops._is_native()


@pytest.mark.usefixtures("verbs")
def test_the_command_line_writes_a_report(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(geometric, "DATABASE", 2000)
    options = ["--only", "clustering,knn", "--threads", "1", "--repeats", "1"]
    options += ["--report", str(tmp_path / "speed")]
    result = CliRunner().invoke(app, ["bench", *options], catch_exceptions=False)
    assert result.exit_code == 0 and "SciPy" in result.stdout
    (table,) = json.loads((tmp_path / "speed" / "rows.json").read_text())
    assert [cells[0] for cells in table["rows"]] == ["`clustering`", "`knn`"]
    assert all(cells[2] > 0 and "SciPy" in cells[3] for cells in table["rows"])
    with pytest.raises(ConfigError, match="never rewritten"):
        CliRunner().invoke(app, ["bench", *options], standalone_mode=False, catch_exceptions=False)
