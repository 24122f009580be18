"""What robots did is counted as it was: kidnapped ones, streams, paths whose loops are closed."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from segloc_lab.peers.loops import ate, chained, tied
from segloc_lab.protocols import ageing, change, first_fix, kidnapping, live_streams, rivals
from segloc_lab.protocols.follower import Follower
from segloc_lab.report import entries

from segloc import (
    Config,
    ConfigError,
    Localizer,
    MemoryRecording,
    Scan,
    __version__,
    build_map,
    geometry,
)
from segloc.live import Status
from segloc.loops.graph import Edges


def test_a_right_loop_takes_the_drift_out_of_a_path() -> None:
    turn = geometry.yaw_transform(2 * np.pi / 40, (2.0, 0.0, 0.0))
    truths = chained(np.tile(turn, (41, 1, 1)))
    wrong = geometry.yaw_transform(2 * np.pi / 40 + 0.003, (2.02, 0.0, 0.0))
    odometry = chained(np.tile(wrong, (41, 1, 1)))
    covariance = np.diag([1e-5] * 3 + [1e-2] * 3)[None]
    T = (geometry.inverse(truths[0]) @ truths[40])[None]
    loops = Edges(np.array([0]), np.array([40]), T, covariance)
    assert ate(truths @ geometry.yaw_transform(0.0), truths) == pytest.approx(0.0, abs=1e-9)
    assert ate(tied(odometry, loops), truths) < 0.5 * ate(odometry, truths)


def test_views_are_compared_at_every_turn() -> None:
    here = np.random.default_rng(2).uniform(size=(2, kidnapping.SECTORS))
    differs, turn = kidnapping._unlike(here, np.roll(here, -7, axis=1))
    assert differs == 0.0 and turn == pytest.approx(-2.0 * np.pi * 7 / kidnapping.SECTORS)


class Storey:
    """A drive along x whose scans hold the number of the storey."""

    name, poses, stamps = "storey", None, np.arange(400) * 0.5
    indices = np.arange(400)

    def __init__(self, number: int) -> None:
        self.number = number

    def __len__(self) -> int:
        return 400

    def scan(self, i: int) -> Scan:
        return Scan(np.full((1, 3), [i, 0, self.number], dtype=np.float32))


def test_a_lift_leads_to_the_same_place_of_another_storey(monkeypatch: pytest.MonkeyPatch) -> None:
    world = object.__new__(kidnapping.Building)
    world.kind, world.seed = kidnapping.LIFTED_KINDS[0], 1
    storeys = tuple(map(Storey, range(3)))
    world.drive, world._length = kidnapping.Joined(storeys[0], storeys), 400
    poses = [[geometry.yaw_transform(0.0, (x / 2, 0, 3 * z)) for x in range(400)] for z in range(3)]
    world.truths = np.concatenate(poses)
    tried: list[Any] = []
    monkeypatch.setattr(world, "_tried", lambda *trial: tried.append(trial))
    world.storeys, loaded = [0, 1, 2], []
    monkeypatch.setattr(world, "_judged", lambda carried, played: None)
    monkeypatch.setattr(world, "_counted", lambda *trial: tried.append(trial))
    monkeypatch.setattr(kidnapping, "_loading", lambda *given: loaded.append(given))
    for number, expected in enumerate(kidnapping.LIFTED):
        world.lifted(number)
        _, way, carried, heights = tried[-1]
        assert way == expected
        seen = np.array([carried.scan(i).points[0] for i in range(len(carried))])
        first = carried.first
        (start,), (end,) = set(seen[:first, 2]), set(seen[first:, 2])
        assert start != end and seen[first, 0] == seen[first - 1, 0]
        assert np.allclose(world.truths_of(carried)[:, 2, 3], 3.0 * seen[:, 2])
        step = geometry.inverse(carried.poses[first - 1]) @ carried.poses[first]
        assert np.linalg.norm(step[:3, 3]) < 0.5  # the odometry notices nothing
        if heights is None:
            assert way == "lift" or "map" in way  # what was judged is None here, too
            continue
        if way == "lift, height before":
            assert [height is None for height in heights] == [k >= first for k in range(len(seen))]
            continue
        off = np.abs(np.array([z for z, _ in heights]) - 3.0 * seen[:, 2]) > 2.0
        assert off.mean() < 0.1
        assert (off[first : first + 10].mean() > 0.9) == (way == "lift, late height")
    rises = {(old, new): T[2, 3] for old, new, _, T in loaded if T is not None}
    assert rises and all(rise == 3.0 * (new - old) for (old, new), rise in rises.items())
    assert len(loaded) == 2 and loaded[1][3] is None


@pytest.mark.slow
def test_rivals_follow_a_robot_at_its_smallest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("embreex")
    pytest.importorskip("small_gicp")
    for name, metres in (("BEFORE_M", 5.0), ("AFTER_M", 4.0), ("RECOVERED_M", 4.0)):
        monkeypatch.setattr(kidnapping, name, metres)
    kind = kidnapping.Kind("offices", "vlp16", 40.0, 60.0, 0.5, "wheeled")
    monkeypatch.setattr(rivals, "ALIKE_KINDS", (kind,))
    out = tmp_path / "rivals.jsonl"
    monkeypatch.setattr("sys.argv", ["rivals", "--worlds", "1", "--out", str(out)])
    rivals.main()
    found = rivals.followed_of(entries(out))
    assert [f.system for f in found] == sorted(rivals.SYSTEMS)
    for each in found:
        assert len(each.right) == len(each.scores) == each.first + len(each.path_m)
    followed = next(f for f in found if f.system == "particle-filter")
    begun = followed.within.index(True) + 5
    assert all(followed.right[begun : followed.first])  # until it is put elsewhere
    printed = capsys.readouterr().out
    assert all(f"| {name} |" in printed for name in ("segloc", *rivals.ONCE.values()))
    # Answers accepted at one world by what another one implies: nothing without another.
    assert rivals._threshold(found, found[0].seed) == np.nextafter(np.inf, 0)
    rivals.main()
    assert rivals.followed_of(entries(out)) == found  # nothing is done twice


@pytest.mark.slow
def test_robots_are_switched_on_at_their_smallest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("embreex")
    kind = kidnapping.Kind("offices", "vlp16", 40.0, 40.0, 1.0, "wheeled")
    monkeypatch.setattr(first_fix, "KINDS", (kind,))
    monkeypatch.setattr(first_fix, "FOLLOWED_M", 6.0)
    out, report = tmp_path / "first.jsonl", tmp_path / "report"
    command = ["first_fix", "--worlds", "1", "--trials", "2", "--out", str(out)]
    monkeypatch.setattr("sys.argv", [*command, "--report", str(report)])
    first_fix.main()
    robots = entries(out)
    assert [r["number"] for r in robots] == [0, 1] and all(r["false_m"] == 0.0 for r in robots)
    fixes = [r["first_fix_m"] for r in robots]
    assert any(fix is not None for fix in fixes)
    at_once = sum(fix == 0.0 for fix in fixes)
    assert f"| 2 | {at_once} of 2" in (report / "REPORT.md").read_text()


@pytest.mark.slow
def test_a_map_grows_old_at_its_smallest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("embreex")
    monkeypatch.setattr(ageing, "LENGTH_M", 12.0)
    monkeypatch.setattr(ageing, "AZIMUTHS", 300)
    monkeypatch.setattr(ageing, "PLACES", ("offices",))
    monkeypatch.setitem(ageing.KINDS, "offices", replace(ageing.KINDS["offices"], size_m=40.0))
    some = {name: ageing.CHANGES[name] for name in ("leaves fallen", "a quarter rebuilt")}
    monkeypatch.setattr(ageing, "CHANGES", some)
    out, report = tmp_path / "ageing.jsonl", tmp_path / "report"
    command = ["ageing", "--worlds", "1", "--weeks", "2", "--out", str(out)]
    monkeypatch.setattr("sys.argv", [*command, "--report", str(report)])
    ageing.main()
    changes, year = entries(out)
    assert [each["change"] for each in changes["found"]] == ["a quarter rebuilt"]  # no trees inside
    first, second = year["found"]
    assert first["map of June"] == first["updated"]  # nothing was added yet
    assert second["segments"] > first["segments"]
    told = (report / "REPORT.md").read_text()
    assert "| a quarter rebuilt |" in told and "| offices | 1 to 1 |" in told


@pytest.mark.slow
def test_an_hour_of_a_lidar_alone_at_its_smallest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("kiss_icp")
    pytest.importorskip("embreex")
    monkeypatch.setattr(live_streams, "STREET_M", 6.0)
    samples = list(live_streams.alone("vlp16", 5200, 0.1, tmp_path, float("inf"), thin=4))
    assert [s["scans"] for s in samples] == list(range(6, 61, 6))
    assert all(min(s["ms"].values()) > 0 for s in samples)
    live_streams.report(samples, tmp_path / "report")
    assert samples[-1]["localized"] > 50 and not samples[-1]["false_m"]
    assert "memory grows by" in (tmp_path / "report" / "REPORT.md").read_text()
    grown = [{"mb": mb} for mb in (100.0, 108.0, 103.0)]
    assert live_streams.growth(grown) == pytest.approx(0.08)


def test_a_robot_is_followed_alike_by_the_same_version_in_another_process(plaza: Plaza) -> None:
    walk, config = PlazaSequence(plaza, 12), Config(threads=1)
    scans = [walk.scan(i) for i in range(len(walk))]
    localizer = Localizer(build_map(MemoryRecording(scans), config), config)
    here = live_streams.Stream("plaza", 0, localizer, walk, walk.poses, walk.poses, rate_hz=1.0)
    follower = Follower(Path(sys.executable), [(scan.points, scan.T_odom_sensor) for scan in scans])
    there = replace(here, follower=follower)
    ours, theirs = (list(live_streams._along(each, range(6))) for each in (here, there))
    assert follower.version == __version__ and ours[-1].state.status is Status.LOCALIZED
    for one, other in zip(ours, theirs, strict=True):
        assert one.state.status is other.state.status and one.state.stamp == other.state.stamp
        T, T_other = one.state.T_map_base, other.state.T_map_base
        if T is None or T_other is None:
            assert T is T_other
        else:
            assert np.array_equal(T, T_other)


@pytest.mark.parametrize("beams", [None, 32, 16])
def test_a_sensor_with_fewer_beams_has_those_of_the_whole(beams: int | None) -> None:
    whole, some = (change.sensor_of("os1-64", 512, each) for each in (None, beams))
    count, left = (len(each.elevations_deg) for each in (whole, some))
    assert left == (beams or 64)
    for k in range(left):
        own, of = k, k * (count // left)
        assert some.elevations_deg[own] == whole.elevations_deg[of]
        turns, turned = whole.azimuths_deg, some.azimuths_deg
        assert turned[own % len(turned)] == turns[of % len(turns)]
    with pytest.raises(ConfigError, match="--beams 48"):
        change.sensor_of("os1-64", 512, 48)


def test_false_answers_of_a_place_that_changed_are_counted_by_method() -> None:
    entry = {"world": "town", "clouds": "single", "sensor": "s", "map": "own", "way": "w"}
    answers = [
        {**entry, "method": method, "right": [True] * 4, "false": false}
        for method, false in (("profile", 0), ("dsm", 7))
    ]
    columns, (row,) = change.table(answers)
    counted = dict(zip(columns, row, strict=True))
    assert (counted["false, profile"], counted["false, dsm"]) == (0, 7)
