"""A pose over a restart: right, moved meanwhile, of another map, damaged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza
from samples.streams import T_MAP_ODOM, error_m, feed, walked

from segloc import Localizer, SegmentMap, geometry
from segloc.live import LiveCore, PoseKeeper, State
from segloc.types import Pose


def drive(
    localizer: Localizer, plaza: Plaza, keeper: PoseKeeper, count: int = 2, x: float = -14.0,
    T_map_odom: Pose = T_MAP_ODOM, start_s: float = 100.0,
) -> list[tuple[State, float]]:  # fmt: skip
    """States after each scan, and how far they are off."""
    core, states = LiveCore(localizer, keeper=keeper), []
    walk = walked(plaza, count, begin=(x, 1.0), T_map_odom=T_map_odom, start_s=start_s, step=0.5)
    for events, truth in walk:
        state = feed(core, events)[-1]
        states.append((state, error_m(state, truth)))
    keeper.flush()
    return states


@pytest.mark.parametrize("restarted", [False, True])
def test_a_kept_pose_is_checked_near_it(
    localizer: Localizer, plaza: Plaza, tmp_path: Path, restarted: bool
) -> None:
    """With the odometry of before, or with one that begins where the robot stands."""
    file = tmp_path / "pose.json"
    drive(localizer, plaza, PoseKeeper(file))
    kept = json.loads(file.read_text())
    assert np.allclose(
        kept["T_map_base"], geometry.yaw_transform(0.02, (-13.5, 1.1, 1.8)), atol=0.3
    )
    keeper, T = PoseKeeper(file), T_MAP_ODOM
    if restarted:
        T = geometry.yaw_transform(0.0, (-13.5, 1.1, 1.8))
    (state, error), *_ = drive(localizer, plaza, keeper, x=-13.5, T_map_odom=T, start_s=200.0)
    assert error < 0.3 and state.localized
    assert keeper.notes[0].startswith("kept pose confirmed, 0.")


def test_a_robot_that_was_moved_is_found_anew(
    localizer: Localizer, plaza: Plaza, tmp_path: Path
) -> None:
    keeper = PoseKeeper(tmp_path / "pose.json", check_s=2.0)
    drive(localizer, plaza, keeper, x=-20.0)
    keeper = PoseKeeper(keeper.path, check_s=2.0)
    states = drive(localizer, plaza, keeper, 6, x=14.0, start_s=300.0)
    assert not states[0][0].localized  # not near, and not elsewhere before that is sure
    assert (
        all(error < 0.5 for state, error in states if state.localized) and states[-1][0].localized
    )
    assert "not confirmed within 2 s" in keeper.notes[0]


def test_a_pose_that_cannot_be_used_is_explained(
    localizer: Localizer, plaza: Plaza, tmp_path: Path
) -> None:
    file = tmp_path / "pose.json"
    drive(localizer, plaza, PoseKeeper(file))
    good = file.read_text()
    for text, states in (
        (good.replace('"map_id": "', '"map_id": "0'), "of another map"),
        (good.replace('"version": 1', '"version": 7'), "not a pose file"),
        (good[:50], "not a pose file"),
        (good, "s old, limit 60 s"),
    ):
        file.write_text(text)
        keeper = PoseKeeper(file, max_age_s=60.0)
        (_, error), *_ = drive(localizer, plaza, keeper, start_s=500.0)
        assert error < 0.3 and states in keeper.notes[0]
    keeper = PoseKeeper(tmp_path / "no" / "folder.json")
    drive(localizer, plaza, keeper)
    assert any("pose not kept" in note for note in keeper.notes)


def test_a_check_ends_with_its_time_and_its_map(
    localizer: Localizer, plaza: Plaza, tmp_path: Path
) -> None:
    file, still = tmp_path / "pose.json", np.eye(4)
    drive(localizer, plaza, PoseKeeper(file))

    def checking() -> PoseKeeper:
        keeper = PoseKeeper(file)
        keeper.use(localizer.prior_map)
        assert keeper.near(1e4, still, still) is not None
        keeper.use(localizer.prior_map)  # loaded again
        assert keeper.near(1e4 + 1.0, still, still) is not None
        return keeper

    assert checking().near(1e4 - 7200.0, still, still) is None  # the clock was set back
    keeper, other = checking(), SegmentMap.load(saved(localizer.prior_map, tmp_path))
    other.origin[:] += 1000.0
    keeper.use(other)
    assert keeper.near(1e4 + 2.0, still, still) is None


def saved(prior_map: SegmentMap, folder: Path) -> Path:
    prior_map.save(folder / "copy.segmap")
    return folder / "copy.segmap"
