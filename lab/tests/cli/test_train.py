"""``segloc train`` from the shell: datasets, networks, scores, and errors of wrong input."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.simulation import Route, simulate_session, town, vlp16
from segloc_lab.training.extract import ExtractConfig, extract_session
from segloc_lab.training.shards import INDEX, Session, finish, load_dataset, write_shard
from typer.testing import CliRunner

from segloc import geometry
from segloc.errors import ConfigError, DatasetError, MissingDependency
from segloc.frontend.segmentation import Segmenter
from segloc.tools.cli import app
from segloc.tools.io import Trajectory, read_trajectory, write_tum
from segloc.tools.io.scans import write_scan

runner = CliRunner()


def run(*arguments: object) -> str:
    result = runner.invoke(app, [str(a) for a in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve scans along a street of boxes of different sizes."""
    rng = np.random.default_rng(0)
    parts = [np.column_stack([rng.uniform(-60, 80, (20000, 2)), 0.02 * rng.normal(size=20000)])]
    for i in range(36):
        size = rng.uniform([1.0, 0.6, 1.5], [4.0, 2.0, 4.0])
        at = [6.0 * (i // 2) - 40, (7 + 3 * (i % 4)) * (-1) ** i, size[2] / 2 - 0.05]
        face = rng.uniform(-0.5, 0.5, (600, 3))
        axis = rng.integers(3, size=600)
        face[np.arange(600), axis] = np.sign(face[np.arange(600), axis]) / 2
        parts.append(face * size + at)
    world = np.concatenate(parts)
    folder = tmp_path_factory.mktemp("street")
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, 0, 3] = 2.0 * np.arange(12)
    poses[:, 2, 3] = 1.7
    for i, pose in enumerate(poses):
        points = (world - pose[:3, 3]).astype(np.float32)
        points = points[
            (points[:, 0] ** 2 + points[:, 1] ** 2 < 900) & (rng.random(len(points)) < 0.7)
        ]
        write_scan(folder / f"{i:04d}.npy", points)
    write_tum(folder / "poses.tum", Trajectory(np.arange(12.0), poses))
    return folder


@pytest.mark.slow
def test_from_recordings_to_scores(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch")
    torch.set_num_threads(1)
    data = tmp_path / "data"
    arguments = ("train", "extract", recording, recording, "--poses", recording / "poses.tum")
    arguments += ("--select", "0:7", "--select", "4:11", "--length", 10, "--length", 0)
    arguments += ("--every", 4, "--place", "street", "--sensor", "eye", "--out", data)
    first = run(*arguments)
    assert "matching pairs across sessions" in first
    assert "aligned" in first
    dataset = load_dataset(data)
    assert dataset.sensor_names == ("eye",)
    assert set(np.unique(dataset.lengths)) == {0.0, 10.0}
    assert len(np.unique(dataset.sessions)) == 2
    shards = {path: path.stat().st_mtime_ns for path in data.glob("*--*")}
    assert "exists" in run(*arguments)
    assert shards == {path: path.stat().st_mtime_ns for path in data.glob("*--*")}
    weights = tmp_path / "dsm.safetensors"
    config = tmp_path / "small.yaml"
    config.write_text("classes: 8\nwarmup: 2\nvalidate_every: 5\n")
    run("train", "dsm", data, "--out", weights, "--steps", 5, "--config", config)
    (tmp_path / "geo").mkdir()
    monkeypatch.chdir(tmp_path)  # where a folder has a descriptor's name
    for name in (weights, "geo"):
        assert "recall@25" in run("train", "score", name, data)


@pytest.mark.slow
def test_what_changed_is_extracted_again(recording: Path, tmp_path: Path) -> None:
    data, days = tmp_path / "data", {"monday": "0:7", "tuesday": "4:11"}
    for day in days:
        shutil.copytree(recording, tmp_path / day)

    def extracted(poses: str = "poses.tum", *more: object, back: bool = False) -> str:
        arguments: list[object] = ["train", "extract", *more, "--out", data]
        for day in sorted(days, reverse=back):
            arguments += [tmp_path / day, "--poses", tmp_path / day / poses, "--select", days[day]]
        return run(*arguments, "--length", 10, "--every", 4)

    extracted()
    before = load_dataset(data)
    assert extracted().count("exists") == 2
    extracted(back=True)  # under other names
    again = load_dataset(data)
    assert len(np.unique(again.sessions)) == 2
    assert len(again) == pytest.approx(len(before), rel=0.05)
    extracted()
    found = read_trajectory(recording / "poses.tum")
    moved = geometry.yaw_transform(0.0, (1.5, 0.0, 0.0)) @ found.poses
    write_tum(tmp_path / "monday" / "moved.tum", Trajectory(found.stamps, moved))
    shutil.copy(recording / "poses.tum", tmp_path / "tuesday" / "moved.tum")
    assert extracted("moved.tum").count("exists") == 0  # tuesday is aligned with monday
    shift = np.median(load_dataset(data).centroids[:, 0]) - np.median(before.centroids[:, 0])
    assert shift == pytest.approx(1.5, abs=0.3)
    for path in (tmp_path / "tuesday").glob("*.npy"):
        np.save(path, np.load(path) * np.float32(0.5))
    assert extracted("moved.tum").count("exists") == 1
    config = tmp_path / "robot.yaml"
    config.write_text("local_cloud: {body: [[-9, -9, -9], [9, 9, 9]]}\n")
    many = len(load_dataset(data))
    assert extracted("moved.tum", "--config", config).count("exists") == 0
    assert len(load_dataset(data)) < many


def test_wrong_input(recording: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    with pytest.raises(ConfigError, match="and not both"):
        run("train", "extract", "--out", data)
    with pytest.raises(ConfigError, match="no scene 'moon'"):
        run("train", "extract", "--simulate", "moon:1", "--out", data)
    with pytest.raises(ConfigError, match="write town:10"):
        run("train", "extract", "--simulate", "town", "--out", data)
    with pytest.raises(ConfigError, match="no sensor 'eyes'"):
        run("train", "extract", "--simulate", "town:1", "--sensors", "eyes", "--out", data)
    with pytest.raises(ConfigError, match="--select is given 2 times for 1"):
        run("train", "extract", recording, "--select", "1", "--select", "2", "--out", data)
    with pytest.raises(DatasetError, match="needs a pose for every scan"):
        run("train", "extract", recording, "--out", data)
    with pytest.raises(DatasetError, match="no index"):
        load_dataset(tmp_path)
    (tmp_path / INDEX).write_text('{"version": 99}')
    with pytest.raises(DatasetError, match="not an index of format version"):
        load_dataset(tmp_path)


def test_wrong_training_settings(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    config = tmp_path / "train.yaml"
    config.write_text("stepz: 3\n")
    with pytest.raises(ConfigError, match="stepz"):
        run("train", "dsm", tmp_path, "--out", tmp_path / "w.safetensors", "--config", config)
    config.write_text("classes: 3\n")
    with pytest.raises(ConfigError, match=r"^training: loss"):
        run("train", "dsm", tmp_path, "--out", tmp_path / "w.safetensors", "--loss", "none",
            "--config", config)  # fmt: skip


def test_training_without_torch_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingDependency, match=r"training needs torch .*pip install 'torch"):
        run("train", "dsm", tmp_path, "--out", tmp_path / "w.safetensors")


@pytest.mark.slow
def test_simulation_knows_the_objects(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    world = town(11, size_m=130.0)
    way = tuple(world.roads.walk(np.random.default_rng(0), [0], 30.0, avoid=[]))
    config = ExtractConfig(lengths_m=(16.0, 0.0))
    sessions = [Session("town", str(k), "vlp16") for k in range(2)]
    for k, session in enumerate(sessions):
        drive = simulate_session(world, k, Route(way, length_m=30.0), vlp16(450), seed=k)
        write_shard(tmp_path, session, extract_session(drive, Segmenter().segment, config), "x")
    counts = finish(tmp_path, sessions, config.label)
    dataset = load_dataset(tmp_path)
    assert len(dataset) == counts.segments > 50
    assert (dataset.objects >= 0).mean() > 0.9
    assert counts.agreeing > 0.7
