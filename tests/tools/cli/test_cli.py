"""The command line, end to end on a toy town, and what it makes of wrong input."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from samples.walk import run
from scipy.spatial.transform import Rotation

from segloc.map.segment_map import SegmentMap
from segloc.tools.io import Trajectory, read_trajectory, write_scan, write_tum

SCANS = 30
PICTURES = {"errors.png", "trajectory.png"}
PICTURE = {"localizations.jsonl", "poses.tum", "summary.json", *PICTURES}


def toy_town(rng: np.random.Generator) -> np.ndarray:
    """Boxes of many sizes on rough ground, as points."""
    ground = rng.uniform([-60, -45, 0], [120, 45, 0.04], (24_000, 3))
    boxes = []
    for x, y in rng.uniform([-55, -40], [115, 40], (110, 2)):
        size = rng.uniform([0.4, 0.4, 1.5], [4, 4, 5])
        faces = rng.uniform(-0.5, 0.5, (int(90 * size[2]), 3))
        axis = rng.integers(0, 2, len(faces))
        faces[np.arange(len(faces)), axis] = np.sign(faces[np.arange(len(faces)), axis]) / 2
        turn = Rotation.from_euler("z", rng.uniform(0, 90), degrees=True).as_matrix()
        if abs(y) > 4:
            boxes.append((faces * size) @ turn.T + [x, y, size[2] / 2])
    return np.concatenate([ground, *boxes])


@dataclass
class Toy:
    """Two traversals of one place in folders of scans, and a map of the first."""

    root: Path
    map: Path

    def __getattr__(self, name: str) -> Path:
        return self.root / name


def record(folder: Path, town: np.ndarray, rng: np.random.Generator, y: float) -> None:
    folder.mkdir()
    poses = np.tile(np.eye(4), (SCANS, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("z", rng.normal(0, 0.05, (SCANS, 1))).as_matrix()
    poses[:, :3, 3] = np.stack([2.0 * np.arange(SCANS), np.full(SCANS, y), np.full(SCANS, 1.7)], 1)
    for i, T in enumerate(poses):
        seen = town[rng.random(len(town)) < 0.5]
        seen = seen[np.hypot(*(seen - T[:3, 3])[:, :2].T) < 40]
        points = (seen + rng.normal(0, 0.01, seen.shape) - T[:3, 3]) @ T[:3, :3]
        np.save(folder / f"{i:04d}.npy", points.astype(np.float32))
    write_tum(folder / "poses.tum", Trajectory(np.arange(SCANS), poses))


@pytest.fixture(scope="session")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    root, rng = tmp_path_factory.mktemp("toy"), np.random.default_rng(5)
    town = toy_town(rng)
    record(root / "run_1", town, rng, 0.0)
    record(root / "run_2", town, rng, 1.0)
    run("map", "build", root / "run_1", "--poses", "poses.tum", "--out", root / "toy.segmap")
    return Toy(root, root / "toy.segmap")


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., None]:
    """Expect one line on stderr that matches, exit status 1, and no new file."""

    def check(match: str, *arguments: Any) -> None:
        before = files(tmp_path)
        capsys.readouterr()
        assert run(*arguments) == 1
        out, err = capsys.readouterr()
        assert out == "" and err.startswith("segloc: error: ") and err.count("\n") == 1
        assert re.search(match, err), err
        assert files(tmp_path) == before

    return check


def read_records(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "localizations.jsonl").read_text().splitlines()]


def localize_toy(toy: Toy, out: Path, *more: Any) -> dict[str, Any]:
    arguments = ["--poses", "poses.tum", "--truth", "poses.tum", "--every", 12, *more]
    assert run("localize", toy.run_2, "--map", toy.map, "--out", out, *arguments) == 0
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


@pytest.mark.slow
def test_a_second_traversal_is_localized(
    toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = localize_toy(toy, tmp_path / "out")
    assert (summary["queries"], summary["within_coverage"]) == (4, 4)
    assert (summary["correct"], summary["false"]) == (4, 0)
    assert summary["translation_error_m"]["p95"] < 0.2
    assert set(files(tmp_path / "out")) == PICTURE
    printed, remarks = capsys.readouterr()
    assert "4 of 4" in printed and remarks == "" and len(printed.splitlines()) < 25
    records = read_records(tmp_path / "out")
    assert [r["index"] for r in records] == [6, 12, 18, 24]
    spent = [r["ms"]["processor"] for r in records]
    assert min(spent) > 0 and summary["ms"]["processor"] == pytest.approx(np.median(spent), 0.01)
    assert ", processor " in printed
    found, truth = (
        read_trajectory(p) for p in (tmp_path / "out" / "poses.tum", toy.run_2 / "poses.tum")
    )
    for entry in records:
        T = np.array(entry["T_map_sensor"])
        assert np.allclose(T, found.at(entry["index"]), atol=1e-8)
        error = np.linalg.norm(T[:3, 3] - truth.at(entry["index"])[:3, 3])
        assert entry["translation_error_m"] == pytest.approx(error)


@pytest.mark.slow
def test_the_same_command_gives_the_same_bytes(toy: Toy, tmp_path: Path) -> None:
    def without_times(out: Path) -> list[str]:
        lines = (out / "localizations.jsonl").read_text().splitlines()
        return [re.sub(r'"ms": \{[^}]*\}', "", line) for line in lines]

    localize_toy(toy, tmp_path / "a", "--threads", 1)
    localize_toy(toy, tmp_path / "b", "--threads", 2)
    assert without_times(tmp_path / "a") == without_times(tmp_path / "b")
    for name in ("poses.tum", "trajectory.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    again = tmp_path / "again.segmap"
    assert run("map", "build", toy.run_1, "--poses", "poses.tum", "--out", again) == 0
    assert again.read_bytes() == toy.map.read_bytes()


@pytest.mark.slow
def test_scans_alone_without_poses_or_truth(toy: Toy, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("localize", toy.run_2, "--map", toy.map, "--select", "3:5,9", "--out", out) == 0
    records = read_records(out)
    assert [r["index"] for r in records] == [3, 4, 5, 9]
    assert all(r["counts"]["scans"] == 1 and "correct" not in r for r in records)
    assert json.loads((out / "summary.json").read_text())["false"] is None


@pytest.mark.slow
def test_a_blind_scan_among_others_is_not_an_error(toy: Toy, tmp_path: Path) -> None:
    run_2 = tmp_path / "run_2"
    shutil.copytree(toy.run_2, run_2)
    np.save(run_2 / "0003.npy", np.empty((0, 3), np.float32))
    np.save(run_2 / "0004.npy", np.full((50, 3), np.nan, np.float32))
    np.save(run_2 / "0005.npy", np.eye(3, dtype=np.float32))
    for poses in ([], ["--poses", "poses.tum"]):
        out = tmp_path / f"out{len(poses)}"
        arguments = ["--map", toy.map, "--select", "0:6", "--out", out, *poses]
        assert run("localize", run_2, *arguments) == 0
        records = read_records(out)
        assert len(records) == 7
        if not poses:
            blind = {r["index"]: r["reason"] for r in records if 3 <= r["index"] <= 5}
            assert blind == {3: "no points", 4: "no points", 5: "no segments"}
    assert run("map", "build", run_2, "--poses", "poses.tum", "--out", tmp_path / "m.segmap") == 0


@pytest.mark.slow
def test_map_info_and_merge(toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    second, both = tmp_path / "second.segmap", tmp_path / "both.segmap"
    arguments = ["--poses", "poses.tum", "--select", ":20", "--every", 10, "--out", second]
    assert run("map", "build", toy.run_2, "--method", "profile", *arguments) == 0
    assert run("map", "merge", toy.map, second, toy.map, "--out", both) == 0
    sizes = {}
    for path in (toy.map, second, both):
        capsys.readouterr()
        assert run("map", "info", path, "--json") == 0
        sizes[path] = json.loads(capsys.readouterr().out)
    assert sizes[both]["segments"] == sizes[toy.map]["segments"] + sizes[second]["segments"]
    assert sizes[both]["sessions"] == 2
    assert yaml.safe_load(sizes[second]["metadata"]["config"])["method"] == "profile"
    assert run("map", "info", both) == 0
    assert str(sizes[both]["segments"]) in capsys.readouterr().out


@pytest.mark.slow
def test_config_and_version(capsys: pytest.CaptureFixture[str], toy: Toy, tmp_path: Path) -> None:
    assert run("config") == 0
    text = capsys.readouterr().out
    (tmp_path / "config.yaml").write_text(text)
    assert yaml.safe_load(text)["method"] == "profile"
    assert run("doctor", toy.run_2, "--config", tmp_path / "config.yaml") == 0
    capsys.readouterr()
    assert run("--version") == 0
    assert re.fullmatch(r"segloc \d+\.\d+\.\d+\n", capsys.readouterr().out)
    for order in (("--version", "--verbose"), ("--verbose", "--version")):
        assert run(*order) == 0
        first, python, machine, *others = capsys.readouterr().out.splitlines()
        assert first.startswith("segloc ") and platform.python_version() in python
        assert "cores" in machine and f"numpy {np.__version__}" in others
        assert not any(line.startswith("pytest") for line in others)
    assert run("--verbose") == 2


@pytest.mark.slow
def test_recordings_that_cannot_be_used(
    toy: Toy, tmp_path: Path, refused: Callable[..., None]
) -> None:
    empty, short = tmp_path / "empty", tmp_path / "short"
    empty.mkdir()
    short.mkdir()
    for i in range(3):
        shutil.copy(toy.run_2 / f"{i:04d}.npy", short)
    whole = (short / "0001.npy").read_bytes()
    (short / "0001.npy").write_bytes(whole[: len(whole) // 2])
    cases = [
        ("empty.*no scans", empty, []),
        ("nowhere.*no such folder", tmp_path / "nowhere", []),
        (r"none\.tum: no such file", toy.run_2, ["--poses", "none.tum"]),
        ("selects none", toy.run_2, ["--select", "500:"]),
        ("neither a number nor a range", toy.run_2, ["--select", "a:b"]),
        ("--every must be a positive", toy.run_2, ["--every", "0"]),
        ("--every must be a positive", toy.run_2, ["--every", "nan"]),
        ("--every needs --poses", toy.run_2, ["--every", "5"]),
        ("no stretch", toy.run_2, ["--every", "500", "--truth", "poses.tum"]),
    ]
    out = tmp_path / "out"
    for match, folder, more in cases:
        refused(match, "localize", folder, "--map", toy.map, "--out", out, *more)
    refused(r"0001\.npy", "localize", short, "--map", toy.map, "--select", "1:", "--out", out)
    build = ["--poses", toy.run_1 / "poses.tum", "--out", tmp_path / "out.segmap"]
    for match, folder in [("no scans", empty), (r"0001\.npy", short)]:
        refused(match, "map", "build", folder, *build)
    refused("needs a pose", "map", "build", toy.run_1, "--out", tmp_path / "out.segmap")


@pytest.mark.slow
def test_answers_before_a_scan_that_is_cut_off_are_kept(
    toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(3):
        shutil.copy(toy.run_2 / f"{i:04d}.npy", tmp_path)
    whole = (tmp_path / "0002.npy").read_bytes()
    (tmp_path / "0002.npy").write_bytes(whole[: len(whole) // 2])
    drive = tmp_path / "drive"
    for name, more in (("out", []), ("detail", ["--debug"])):
        out = tmp_path / name
        assert run("localize", tmp_path, "--map", toy.map, "--out", out, *more) == 1
        err = capsys.readouterr().err
        assert "2 of 3 queries" in err and "0002.npy" in err.splitlines()[-1]
        assert [record["index"] for record in read_records(out)] == [0, 1]
        assert len([*out.glob("debug/*.npz")]) == (2 if more else 0)
    poses = ("--poses", toy.run_2 / "poses.tum")
    assert run("live", tmp_path, "--map", toy.map, *poses, "--out", drive) == 1
    assert "0002.npy" in capsys.readouterr().err.splitlines()[-1]
    assert len((drive / "states.jsonl").read_text().splitlines()) == 2


def test_poses_for_some_of_the_scans(
    toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The others are left out and counted, whatever the verb."""
    rows = (toy.run_2 / "poses.tum").read_text().splitlines()[1:]
    some, few = tmp_path / "some.tum", tmp_path / "few.tum"
    some.write_text("\n".join(rows[::2]))
    few.write_text("\n".join(rows[:8]))
    posed, out = [toy.run_2, "--poses", some], tmp_path / "out"
    there = ["--map", toy.map, "--out", out]
    cases: list[tuple[list[Any], str]] = [
        (["doctor", *posed], "note: 15 of 30 scans dropped"),
        (["map", "build", *posed, "--out", tmp_path / "some.segmap"], "15 of 30 scans dropped"),
        (["localize", *posed, *there, "--truth", few], "11 of 15 scans are not scored"),
        (["localize", toy.run_2, *there, "--truth", some], "15 of 30 scans are not scored"),
    ]
    for words, expected in cases:
        capsys.readouterr()
        shutil.rmtree(out, ignore_errors=True)
        assert run(*words) == 0, words
        assert expected in "".join(capsys.readouterr()), words
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["queries"], summary["false"]) == (15, 0)


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.full((50, 3), np.nan), np.eye(3)])
def test_nothing_to_map(
    toy: Toy, tmp_path: Path, refused: Callable[..., None], points: np.ndarray
) -> None:
    np.save(tmp_path / "0.npy", points.astype(np.float32))
    build = ["map", "build", tmp_path, "--poses", toy.run_1 / "poses.tum"]
    build += ["--out", tmp_path / "out.segmap"]
    refused("points in the scan read: check what drops them", *build)
    refused("no segment", *build, "--unchecked")


@pytest.mark.slow
def test_several_recordings_make_one_map_whoever_does_it(
    toy: Toy, tmp_path: Path, refused: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    build = ["map", "build", toy.run_1, toy.run_2, "--poses", "poses.tum", "--every", 10]
    where = ["--epsg", 25832, "--origin", "691600,5336000"]
    here, there, tiles = tmp_path / "here.segmap", tmp_path / "there.segmap", tmp_path / "tiles"
    assert run(*build, *where, "--threads", 2, "--out", here) == 0
    assert run(*build, *where, "--workers", 2, "--out", there) == 0
    assert here.read_bytes() == there.read_bytes()
    assert files(tmp_path) == ["here.segmap", "there.segmap"]
    capsys.readouterr()
    assert run("map", "info", here) == 0
    assert "EPSG:25832" in capsys.readouterr().out
    refused("--level applies", *build, "--level", "--out", there)
    refused("--origin needs --epsg", *build, "--origin", "1,2", "--out", there)
    refused("--origin expects E,N", *build, "--epsg", 25832, "--origin", "1", "--out", there)
    refused("not a bag", "localize", toy.run_2, "--map", here, "--gnss")
    refused("--gnss needs a georeferenced map", "localize", toy.run_2, "--map", toy.map, "--gnss")
    assert run("map", "tile", toy.map, "--size", 50, "--out", tiles) == 0
    assert run("map", "info", tiles) == 0
    assert re.search(r"tiles +│ +\d+ of 50 m", capsys.readouterr().out)
    update = ["map", "update", tiles, toy.run_2, "--poses", toy.run_2 / "poses.tum", "--out"]
    refused("tiles are changed in place", *update, tmp_path / "other")
    assert run(*update, tiles) == 0
    assert run("map", "merge", tiles, here, "--out", tiles) == 0
    assert "tiles changed" in capsys.readouterr().out


def test_maps_that_cannot_be_used(toy: Toy, tmp_path: Path, refused: Callable[..., None]) -> None:
    data, cut = toy.map.read_bytes(), tmp_path / "cut.segmap"
    for share in (0.01, 0.5, 0.99):
        cut.write_bytes(data[: int(len(data) * share)])
        refused(r"cut\.segmap", "localize", toy.run_2, "--map", cut, "--out", tmp_path / "out")
        refused(r"cut\.segmap", "map", "info", cut)
        refused(r"cut\.segmap", "map", "merge", toy.map, cut, "--out", tmp_path / "out.segmap")
    prior_map = SegmentMap.load(toy.map)
    prior_map.fingerprint, other = "other weights", tmp_path / "other.segmap"
    prior_map.save(other)
    refused("other weights", "localize", toy.run_2, "--map", other, "--out", tmp_path / "out")
    refused("other weights", "map", "merge", toy.map, other, "--out", tmp_path / "out.segmap")
    refused("two maps", "map", "merge", toy.map, "--out", tmp_path / "out.segmap")
    refused("no such file", "map", "info", tmp_path / "none.segmap")


def test_configurations_that_cannot_be_used(
    toy: Toy, tmp_path: Path, refused: Callable[..., None]
) -> None:
    build = ["map", "build", toy.run_1, "--poses", "poses.tum", "--out", tmp_path / "out.segmap"]
    refused("no method 'best'", *build, "--method", "best")
    (tmp_path / "bad.yaml").write_text("speed: 1")
    refused("speed", *build, "--config", tmp_path / "bad.yaml")
    refused("none.yaml", *build, "--config", tmp_path / "none.yaml")


def test_outputs_that_cannot_be_written(
    toy: Toy, tmp_path: Path, refused: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        refused("not a folder", "localize", toy.run_2, "--map", toy.map, "--out", out)
    build = ["map", "build", toy.run_1, "--poses", "poses.tum", "--out"]
    refused("is a directory", *build, tmp_path)
    refused("no folder", *build, tmp_path / "none" / "out.segmap")
    monkeypatch.setattr(os, "access", lambda _, mode: mode == os.R_OK)
    refused("or no permission", *build, tmp_path / "out.segmap")
    refused("or no permission", "localize", toy.run_2, "--map", toy.map, "--out", tmp_path / "out")


def test_what_may_be_an_input_is_not_replaced(
    toy: Toy, tmp_path: Path, refused: Callable[..., None]
) -> None:
    run_2 = shutil.copytree(toy.run_2, tmp_path / "run_2")
    localize = ["localize", run_2, "--map", toy.map]
    before = {path: path.read_bytes() for path in [*run_2.iterdir(), toy.map]}
    refused(
        "no .segmap file",
        "map",
        "build",
        run_2,
        "--poses",
        "poses.tum",
        "--out",
        run_2 / "poses.tum",
    )
    refused("no .html file", *localize, "--html", run_2 / "0001.npy")
    refused("poses.tum is no result", *localize, "--poses", "poses.tum", "--out", run_2)
    refused("no .pcd file", "export", toy.map, "--to", "pcd", "--out", toy.map)
    assert before == {path: path.read_bytes() for path in before}


def test_a_full_disk_leaves_nothing_behind(
    toy: Toy, tmp_path: Path, refused: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    more = ["--select", "5", "--out", tmp_path / "out"]
    refused("no space left", "localize", toy.run_2, "--map", toy.map, *more)


@pytest.mark.slow
def test_without_matplotlib_there_is_no_picture(
    toy: Toy, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    localize_toy(toy, tmp_path / "out")
    assert set(files(tmp_path / "out")) == PICTURE - PICTURES
    assert "pip install 'matplotlib" in " ".join(capsys.readouterr().err.split())


def test_a_missing_reader_is_named(
    toy: Toy, tmp_path: Path, refused: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scan(tmp_path / "0.laz", np.eye(3))
    monkeypatch.setitem(sys.modules, "laspy", None)
    match = r"\(extra io\): pip install 'laspy\[lazrs\]"
    refused(match, "localize", tmp_path, "--map", toy.map, "--out", tmp_path / "out")


def test_bugs_show_a_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(SegmentMap, "load", broken)
    with pytest.raises(ZeroDivisionError):
        run("map", "info", "x.segmap")


def test_an_interrupted_import_is_an_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def half_imported(_: Any) -> None:
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr(SegmentMap, "load", half_imported)
    assert run("map", "info", "x.segmap") == 130
    assert capsys.readouterr().err == "segloc: interrupted\n"
