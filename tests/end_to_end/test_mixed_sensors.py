"""One map of a 64-beam and a 16-beam session in one frame, asked by either sensor."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs the extra 'sim'")

from segloc_lab.simulation import (
    Conditions,
    SimulatedSequence,
    hdl64e,
    record,
    simulate_sessions,
    town,
    vlp16,
)

from segloc import SegmentMap, cli
from segloc.io import Trajectory, read_trajectory, write_tum
from segloc.types import Float64

pytestmark = pytest.mark.slow

LENGTH_M = 80.0


def segloc(*arguments: str | Path) -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(sys, "argv", ["segloc", *map(str, arguments), "--threads", "1"])
        with pytest.raises(SystemExit) as left:
            cli.main()
    assert not left.value.code


@dataclass
class Site:
    """Recordings by either sensor, two each, and a map of the first of both."""

    folders: dict[str, list[Path]]
    truths: dict[str, list[Float64]]
    maps: dict[str, Path]


@pytest.fixture(scope="module")
def prior_map(tmp_path_factory: pytest.TempPathFactory) -> Site:
    root = tmp_path_factory.mktemp("mixed")
    found = Site({}, {}, {})
    for name, sensor in (("hdl64e", hdl64e(400)), ("vlp16", vlp16(400))):
        drives: list[SimulatedSequence] = simulate_sessions(
            town(5, size_m=200.0), sensor, [Conditions()] * 2, length_m=LENGTH_M, spacing_m=1.0,
            seed=4,
        )  # fmt: skip
        found.folders[name], found.truths[name] = [], []
        for k, drive in enumerate(drives):
            folder = record(drive, root / f"{name}_{k}", workers=1)
            numbers = np.arange(len(drive), dtype=float)
            write_tum(folder / "poses.tum", Trajectory(numbers, drive.truth))
            found.folders[name].append(folder)
            found.truths[name].append(drive.truth)
        found.maps[name] = root / f"{name}.segmap"
        mapped = found.folders[name][0]
        segloc("map", "build", mapped, "--poses", "poses.tum", "--out", found.maps[name])
    found.maps["both"] = root / "both.segmap"
    with pytest.MonkeyPatch.context() as monkeypatch:
        arguments = ["merge", found.maps["hdl64e"], found.maps["vlp16"], "--out"]
        verb = ["segloc", "map", *map(str, arguments), str(found.maps["both"])]
        monkeypatch.setattr(sys, "argv", verb)
        with pytest.raises(SystemExit) as left:
            cli.main()
        assert not left.value.code
    return found


def localized(prior_map: Site, sensor: str, mapped: str, out: Path) -> tuple[int, int]:
    """How many queries of the sensor's second session are found and how many there are."""
    folder, truth = prior_map.folders[sensor][1], prior_map.truths[sensor][1]
    segloc("localize", folder, "--poses", "poses.tum", "--map", prior_map.maps[mapped],
           "--every", "10", "--out", out)  # fmt: skip
    found = read_trajectory(out / "poses.tum")
    for number, pose in zip(found.stamps, found.poses, strict=True):
        assert np.linalg.norm(pose[:3, 3] - truth[int(number), :3, 3]) < 0.5
    return len(found), len((out / "localizations.jsonl").read_text().splitlines())


def test_both_sessions_are_in_the_map(prior_map: Site) -> None:
    parts = [SegmentMap.load(prior_map.maps[name]) for name in ("hdl64e", "vlp16")]
    both = SegmentMap.load(prior_map.maps["both"])
    assert len(np.unique(both.session)) == 2
    assert len(both) == sum(map(len, parts))


@pytest.mark.parametrize("sensor", ["hdl64e", "vlp16"])
def test_either_sensor_localizes_in_the_map_of_both(
    prior_map: Site, sensor: str, tmp_path: Path
) -> None:
    """No worse than in the map of its own sensor alone, and never wrong."""
    own, asked = localized(prior_map, sensor, sensor, tmp_path / "own")
    both, _ = localized(prior_map, sensor, "both", tmp_path / "both")
    assert asked >= 5
    assert both >= own >= asked - 2


def test_a_map_of_another_sensor(prior_map: Site, tmp_path: Path) -> None:
    """Also that of one that sees less height: a VLP-16 sees façades that an HDL-64E does not."""
    for sensor, mapped in (("hdl64e", "vlp16"), ("vlp16", "hdl64e")):
        found, asked = localized(prior_map, sensor, mapped, tmp_path / sensor)
        assert found >= asked - 2
