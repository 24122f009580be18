"""What the rooms share: clocks, memory, recordings made of others, and KITTI 00's protocols."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from segloc_lab import recordings, stages
from segloc_lab.recordings import kept
from segloc_lab.simulation import Conditions, building, simulate_sessions, vlp16

from segloc import Config, Localizer, build_map
from segloc.system.stage_times import StageTimes


def test_a_single_pass_goes_through_every_stage() -> None:
    walk = PlazaSequence(Plaza(0), steps=4)
    localizer = Localizer(build_map(walk, Config.preset("geo")))
    watch = StageTimes(stages.processor_clock)
    scene, matches = stages.single_pass(localizer, walk.scan(2), watch)
    assert tuple(watch.ms) == ("local cloud", *stages.STAGES)
    assert len(scene.segments) and len(matches)


def test_beams_are_left_out_without_poses() -> None:
    walk = PlazaSequence(Plaza(0), steps=2)
    thinned = recordings.FewerBeams(walk, 8)
    few, all_points = thinned.scan(0), walk.scan(0)
    assert thinned.poses is None and few.T_odom_sensor is None and len(thinned) == 2
    assert 0 < len(few) < len(all_points) / 2 and thinned.name == "plaza, 8 beams"
    assert recordings.Unposed(walk).poses is None


@pytest.mark.slow
def test_scans_of_worlds_that_differ_are_kept_apart(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="the simulator needs segloc-lab")
    worlds = [building(4, size_m=40.0, storeys=2, differ=differ) for differ in (0.0, 1.0)]
    alike, own = (
        simulate_sessions(world, vlp16(60), [Conditions()], length_m=20.0, storey=1)[0]
        for world in worlds
    )
    np.testing.assert_array_equal(alike.truth, own.truth)
    folders = {kept(drive, tmp_path).folder for drive in (alike, own)}
    assert len(folders) == 2
    assert kept(alike, tmp_path).folder in folders
