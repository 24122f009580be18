"""Benchmarks: what they time is right, and what they report is complete."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.bench import fps, geometric, harness, network, query, stream
from segloc_lab.bench import harness as rows
from segloc_lab.cli import bench as suite
from typer.testing import CliRunner

from segloc import Config, ConfigError, _native, build_map
from segloc.cli import app


@pytest.mark.parametrize("sampler", [fps.per_segment, fps.batched, fps.batched_columns])
def test_rival_samplers_take_the_farthest_points(sampler):
    points = harness.segments(4)
    assert np.array_equal(sampler(points, 60), _native.fps(points, 60))
    assert fps.shortfall(points, sampler(points, 60)) > 0.999


def test_rival_neighbours_are_exact():
    database, queries = harness.descriptors(500), harness.descriptors(20, seed=1)
    expected, _ = _native.knn(queries, database, 7)
    assert np.array_equal(geometric.product_and_partition(queries, database, 7), expected)


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
    row = suite.benchmark(name)(1, 1)
    assert row.ours_ms > 0 and all(ms > 0 for ms in row.rivals.values())
    if name == "network" and harness.optional("torch") is not None:
        assert any("PyTorch" in rival for rival in row.rivals)
    (table,) = rows.tables([row])
    shown = [cell for cell in table.rows[0] if isinstance(cell, float)]
    assert any(cell == pytest.approx(row.ours_ms, rel=1e-2) for cell in shown)


@pytest.mark.slow
@pytest.mark.usefixtures("verbs")
def test_the_command_line_writes_a_report(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(geometric, "DATABASE", 2000)
    options = ["--only", "knn", "--threads", "1", "--repeats", "1"]
    options += ["--report", str(tmp_path / "speed")]
    result = CliRunner().invoke(app, ["bench", *options], catch_exceptions=False)
    assert result.exit_code == 0 and "SciPy" in result.stdout
    (table,) = json.loads((tmp_path / "speed" / "rows.json").read_text())
    assert [cells[0] for cells in table["rows"]] == ["`knn`"]
    assert all(cells[2] > 0 and "SciPy" in cells[3] for cells in table["rows"])
    with pytest.raises(ConfigError, match="never rewritten"):
        CliRunner().invoke(app, ["bench", *options], standalone_mode=False, catch_exceptions=False)
