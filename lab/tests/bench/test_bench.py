"""Benchmarks: what they time is right, and what they report is complete."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from segloc_lab.bench import fps, front, geometric, harness, network, versions, worker, works
from segloc_lab.cli import bench as suite
from typer.testing import CliRunner

import segloc
from segloc import ConfigError, MemoryRecording, SeglocError, _native, geometry
from segloc.tools.cli import app


@pytest.mark.parametrize("sampler", [fps.per_segment, fps.batched, fps.batched_columns])
def test_rival_samplers_take_the_farthest_points(sampler):
    points = harness.segments(4)
    assert np.array_equal(sampler(points, 60), _native.fps(points, 60))
    assert fps.shortfall(points, sampler(points, 60)) > 0.999


def test_rival_neighbours_are_exact():
    database, queries = harness.descriptors(500), harness.descriptors(20, seed=1)
    expected, _ = _native.knn(queries, database, 7)
    assert np.array_equal(geometric.product_and_partition(queries, database, 7), expected)


@pytest.mark.parametrize(
    ("given", "cause"),
    [
        ({"names": ("sorting",)}, "no benchmark 'sorting'"),
        ({"names": ("fps",), "against": Path(sys.executable)}, "beside another version"),
        ({"names": ("fps",), "threads": (0,)}, "at least 1"),
        ({"names": ("fps",), "repeats": 0}, "at least 1"),
    ],
)
def test_wrong_requests_are_refused(given, cause):
    with pytest.raises(ConfigError, match=cause):
        suite.Plan(**given)


ALIKE = ("million", "os1_128", "stream_os1_128", "stream_vlp16")
"""Works that are those of another name, where drives are walks and maps are small."""


@pytest.fixture
def small(monkeypatch):
    """Make each benchmark small: a walk across a plaza in place of drives."""
    for module, constant, value in (
        (front, "SEGMENTS", 10),
        (geometric, "DATABASE", 2000),
        (fps, "SEGMENTS", 10),
        (network, "SEGMENTS", 12),
        (network, "CHUNKS", (5,)),
        (harness, "_SGEMM_SIZE", 64),
        (works, "SCANS", 1),
        (works, "MAP_SEGMENTS", 1500),
        (works, "MILLION", 2000),
        (works, "ASIDE_M", 20.0),
        (works, "ALIGNED_M", 20.0),
        (works, "BUILT", 10),
        (works, "drive", walked),
        (works, "SIMULATED", {"MID-360": ("mid360", 20_000)}),
        (front, "drive", walked),
    ):
        monkeypatch.setattr(module, constant, value)


class Walked(PlazaSequence):
    """A walk in place of a simulated drive, with a scan every 4 m."""

    def __init__(self, plaza, steps):
        super().__init__(plaza, steps)
        way = [(-20.0 + 4 * k, 0.5 * k, 1.8) for k in range(steps)]
        self.poses = np.stack([geometry.yaw_transform(0.05 * k, t) for k, t in enumerate(way)])

    @property
    def truth(self):
        return self.poses

    def with_odometry(self):
        return self


def walked(sensor, firings, *, seed=0, length_m=88.0, **_):
    return Walked(Plaza(seed, objects=100, size=150.0), steps=int(length_m / 4))


@pytest.mark.slow
@pytest.mark.parametrize("name", suite.KERNELS)
def test_every_kernel_is_timed_beside_its_bound(name, small):
    """With PyTorch, ONNX Runtime and the other rivals where they are installed."""
    row = suite.kernel(name)(1, 1)
    assert row.ours_ms > 0 and row.bound_ms > 0 and all(ms > 0 for ms in row.rivals.values())
    assert row.rivals or row.skipped or row.note
    if name == "network" and harness.optional("torch") is not None:
        assert any("PyTorch" in rival for rival in row.rivals)
    (table,) = harness.tables([row])
    assert table.rows[0][2] == pytest.approx(row.ours_ms, rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in suite.WORKS if name not in ALIKE])
def test_all_work_is_timed_beside_the_same_version(name, small):
    """Both find the same answers, none is false, and no stage lacks a ratio."""
    plan = suite.Plan((name,), repeats=1, against=Path(sys.executable))
    rows = [row for rows in plan.works() for row in rows]
    counts = {row[1]: (row[2], row[4]) for row in rows if row[1].startswith("answers: ")}
    assert all(ours == other > 0 for ours, other in counts.values())
    assert "answers: false" not in counts
    assert ("answers: found" in counts) == (name not in ("stages", "build", "align"))
    timed = [row for row in rows if row[3] is not None]
    assert timed and all(float(row[2]) >= 0 and row[6] is not None for row in timed)


@pytest.mark.slow
def test_work_is_timed_beside_a_wheel(tmp_path):
    """What is imported is in the wheel."""
    path, package = tmp_path / "segloc-0.whl", Path(segloc.__file__).parent
    native = Path(_native.__file__)
    with zipfile.ZipFile(path, "w") as wheel:
        for each in package.rglob("*"):
            if each.suffix in (".py", ".json", ".safetensors"):
                wheel.write(each, f"segloc/{each.relative_to(package)}")
        wheel.write(native, f"segloc/{native.name}")
    scan = MemoryRecording([harness.Plaza().scan(np.eye(4)).points])
    work = works.Work("a scan", "stages", [works.Input([scan])])
    with versions.commands(path) as found:
        measured = versions.in_turns(found, work, 1, 1)
    assert measured[versions.OTHER].ms.keys() == measured[harness.OURS].ms.keys() != set()
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("segloc/__init__.py", "raise SystemExit")
    with versions.commands(path) as found, pytest.raises(SeglocError, match="worker ended"):
        versions.in_turns(found, work, 1, 1)


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


def test_an_answer_that_faces_elsewhere_is_false() -> None:
    for degrees, metres, expected in (
        (3.0, 1.0, "found"),
        (8.0, 0.0, "false"),
        (180.0, 0.0, "false"),
    ):
        T = geometry.yaw_transform(np.radians(degrees), (metres, 0.0, 0.0))
        answer = segloc.Localized(T_map_sensor=T, covariance=np.eye(6), confidence=1.0)
        assert worker.kind_of(answer, np.eye(4)) == expected
