"""Sessions with drifting poses, each in its own frame, brought into one."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from samples.drift import DRIFT, drifted, errors_across
from samples.executors import Walk
from samples.plaza import Plaza, PlazaSequence
from samples.walk import as_folder, run

from segloc import Config, Localizer, Scan, SegmentMap, geometry
from segloc.errors import ConfigError, DatasetError
from segloc.loops import AlignConfig, Alignment, Reposed, align_sessions
from segloc.loops.align import spread
from segloc.loops.consistency import reject_unsupported
from segloc.loops.growing_map import blocks_of
from segloc.loops.loops import Chain, Loop
from segloc.loops.submaps import Session
from segloc.tools.io import read_trajectory, write_scan
from segloc.types import Float64

pytestmark = pytest.mark.slow

CONFIG = Config(threads=1)


@pytest.fixture(scope="module")
def walks(plaza: Plaza) -> list[Walk]:
    """Two sessions of one plaza, one of another."""
    other = Walk(Plaza(7), 0.0, 6, "other")
    return [Walk(plaza, 0.0, 15, "first"), Walk(plaza, 2.0, 15, "second"), other]


@pytest.fixture(scope="module")
def aligned(walks: list[Walk]) -> Alignment:
    return align_sessions([drifted(w, w.poses, k) for k, w in enumerate(walks)], CONFIG)


def test_sessions_of_one_place_are_joined_and_another_place_stays_apart(
    walks: list[Walk], aligned: Alignment
) -> None:
    assert aligned.components == [[0, 1], [2]]
    off = errors_across(*aligned.poses[:2], walks[0].poses, walks[1].poses)
    assert len(off) == 15
    assert np.median(off) < 0.15
    np.testing.assert_allclose(aligned.poses[2], aligned.odometry[2], atol=1e-9)
    np.testing.assert_allclose(aligned.poses[0][0], aligned.odometry[0][0], atol=1e-9)
    believed = [loop for loop in aligned.loops if loop.accepted]
    assert len(believed) >= 5
    assert all(set(s) == {0, 1} for s in aligned.loop_sessions.tolist())
    after = np.array([loop.after for loop in believed])
    assert np.median(np.linalg.norm(after[:, 3:], axis=1)) < 0.1


def test_threads_do_not_change_a_bit(plaza: Plaza) -> None:
    walks = [Walk(plaza, 0.0, 6, "first"), Walk(plaza, 2.0, 6, "second")]
    settings = AlignConfig(every_m=3.0)
    one, two = (
        align_sessions(
            [drifted(w, w.poses, k) for k, w in enumerate(walks)],
            CONFIG.model_copy(update={"threads": threads}),
            settings,
        )
        for threads in (1, 2)
    )
    assert one.components == [[0, 1]]
    for a, b in zip(one.poses, two.poses, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_cannot_be_aligned_is_said(plaza: Plaza) -> None:
    with pytest.raises(ConfigError, match="no session"):
        align_sessions([])
    without = PlazaSequence(plaza, steps=2)
    without.poses = None  # type: ignore[assignment]
    with pytest.raises(DatasetError, match=r"session 0: plaza: .*needs odometry"):
        align_sessions([without], CONFIG)
    with pytest.raises(DatasetError, match=r"poses of shape \(3, 4, 4\) for 15 scans"):
        Reposed(PlazaSequence(plaza), np.tile(np.eye(4), (3, 1, 1)))

    class Empty(PlazaSequence):
        def scan(self, i: int) -> Scan:
            return Scan(np.empty((0, 3), np.float32), T_odom_sensor=self.poses[i])

    with pytest.raises(DatasetError, match="session 1: plaza: no segments in 2 scans"):
        align_sessions([PlazaSequence(plaza, steps=2), Empty(plaza, steps=2)], CONFIG)


def _session(poses: Float64, anchors: list[int]) -> Session:
    way = geometry.distance_travelled(poses)
    chosen = np.array(anchors, np.int64)
    return Session("s", np.arange(len(poses)), poses, way, chosen)


def test_all_scans_follow_their_submaps() -> None:
    rng = np.random.default_rng(0)
    truth = np.stack([geometry.yaw_transform(0.05 * k, (k, 0.1 * k, 2.0)) for k in range(21)])
    session = _session(DRIFT.odometry(truth, rng), [0, 5, 10, 15, 20])
    nodes = session.node_poses
    np.testing.assert_allclose(spread(session, nodes), session.poses, atol=1e-9)
    frame = geometry.yaw_transform(1.0, (5.0, 6.0, 7.0))
    np.testing.assert_allclose(spread(session, frame @ nodes), frame @ session.poses, atol=1e-9)
    nodes = nodes.copy()
    nodes[2:, 0, 3] += 1.0  # between the second and the third the poses must stretch evenly
    steps = spread(session, nodes)[:, 0, 3] - session.poses[:, 0, 3]
    np.testing.assert_allclose(steps[5:11], np.linspace(0, 1, 6), atol=0.05)
    single = _session(truth[:1], [0])
    np.testing.assert_allclose(spread(single, frame @ single.node_poses)[0], frame @ truth[0])


def test_a_loop_needs_others_that_agree() -> None:
    way = np.stack([geometry.yaw_transform(0.0, (6.0 * k, 0.0, 0.0)) for k in range(30)])
    sessions = [_session(way, list(range(30))), _session(way, list(range(30)))]
    chain = Chain.of(sessions, 200.0)
    right = [(k, 30 + k, np.eye(4)) for k in (3, 4, 5)]
    wrong = [(5, 34, geometry.yaw_transform(0.0, (9.0, 0.0, 0.0))), (25, 40, np.eye(4))]
    loops = [Loop(a, b, T, np.eye(6), "found", 9, 0.9) for a, b, T in right + wrong]
    results = reject_unsupported(chain, loops, AlignConfig())
    assert [loop.accepted for loop in results] == [True] * 3 + [False] * 2
    assert results[3].reason == "0 neighbouring loops agree and 3 do not"
    assert results[4].reason == "0 neighbouring loops agree and 0 do not"
    assert not any(loop.accepted for loop in reject_unsupported(chain, loops[:2], AlignConfig()))


def test_the_command_writes_all_of_it(
    walks: list[Walk], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [
        as_folder(tmp_path / f"${walk.name}_$DATE", drifted(walk, walk.poses, k), "odometry.tum")
        for k, walk in enumerate(walks)
    ]
    out = tmp_path / "out"
    out.mkdir()
    earlier = {"sessions": [{}] * 5, "components": [[0]] * 4}
    (out / "alignment.json").write_text(json.dumps(earlier))
    for name in ("session_4.tum", "odometry_3.tum", "site_3.segmap", "session_5.tum"):
        (out / name).touch()
    assert run("align", *folders, "--poses", "odometry.tum", "--out", out, "--threads", 1) == 0
    assert {path.name for path in out.iterdir() if path.stat().st_size == 0} == {"session_5.tum"}
    output = capsys.readouterr()
    assert "session 2 ($other_$DATE) has no loops" in " ".join(output.err.split())
    facts = json.loads((out / "alignment.json").read_text())
    assert facts["components"] == [[0, 1], [2]]
    assert facts["residual_after"]["median_m"] < 0.1
    with (out / "loops.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(row["accepted"] == "1" for row in rows) == facts["loops"]["accepted"]
    rejected = [row for row in rows if row["accepted"] == "0"]
    assert len(rejected) == facts["loops"]["rejected"]
    assert all(row["reason"] for row in rejected)
    for row in rows:  # residuals before and after of what was believed
        assert row["accepted"] == "0" or float(row["after_m"]) <= float(row["before_m"]) + 0.5
    assert (out / "before_after.png").read_bytes()[:4] == b"\x89PNG"
    poses = read_trajectory(out / "session_1.tum")
    assert len(poses) == 15

    prior_map = SegmentMap.load(out / "site.segmap")
    assert len(np.unique(prior_map.session)) == 2
    assert len(np.unique(SegmentMap.load(out / "site_1.segmap").session)) == 1
    answer = Localizer(prior_map, CONFIG).localize(walks[1].scan(7))
    assert answer.T_map_sensor is not None
    assert np.linalg.norm(answer.T_map_sensor[:3, 3] - poses.poses[7][:3, 3]) < 0.3


def test_a_broken_session_among_good_ones(
    walks: list[Walk], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, other, bare, void = (tmp_path / name for name in ("good", "other", "bare", "void"))
    for k, folder in enumerate((good, other)):
        as_folder(folder, drifted(walks[2], walks[2].poses, k), "odometry.tum")
    bare.mkdir()
    write_scan(bare / "0.npy", walks[0].scan(0).points)
    void.mkdir()
    cut = sorted(other.glob("*.npy"))[-1]
    cut.write_bytes(cut.read_bytes()[:-7])
    posed = ["--poses", good / "odometry.tum", "--threads", 1]
    for session, options, fault in (
        (bare, [], f"{good}: session 0 has no poses"),
        (bare, ["--poses", "odometry.tum"], "odometry.tum: no such file"),
        (bare, ["--every", 0], "every_m"),
        (void, posed, f"{void}: no scans"),
        (other, posed, f"{cut}: "),
    ):
        assert run("align", good, session, "--out", tmp_path / "out", *options) == 1
        assert not (tmp_path / "out").exists()
        output = "".join(capsys.readouterr().err.split("segloc: ")[-1].split())
        assert fault.replace(" ", "") in output


def test_blocks_hold_each_part_once_and_are_few() -> None:
    kinds = set()
    for known in range(300):
        blocks = blocks_of(known)
        assert [part for block in blocks for part in block] == list(range(known))
        assert len(blocks) <= known.bit_length()
        kinds.update(blocks)
    assert sum(map(len, kinds)) <= 300 * 9  # each part is laid out once a size of blocks
