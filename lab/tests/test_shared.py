"""What the rooms share: clocks, memory, recordings made of others, and KITTI 00's protocols."""

from __future__ import annotations

import subprocess
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from segloc_lab import kitti00, recordings, stages
from segloc_lab.bench.harness import Plaza, PlazaWalk

from segloc import Config, Localizer, build_map
from segloc.system.stage_times import StageTimes


def test_stages_add_up_by_the_clock_that_is_handed_in() -> None:
    watch = StageTimes(count().__next__)
    for stage in ("a", "b", "a"):
        with watch(stage):
            pass
    assert watch.ms == {"a": 2000.0, "b": 1000.0}


def test_a_single_pass_goes_through_every_stage() -> None:
    walk = PlazaWalk(Plaza(), steps=4)
    localizer = Localizer(build_map(walk, Config.preset("geo")))
    watch = StageTimes(stages.processor_clock)
    scene, matches = stages.single_pass(localizer, walk.scan(2), watch)
    assert tuple(watch.ms) == ("local cloud", *stages.STAGES)
    assert len(scene.segments) and len(matches)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux counts it")
def test_memory_rises_by_what_is_taken() -> None:
    code = (  # in a process of its own: here, what other tests have left is freed at any time
        "import numpy as np; from segloc_lab import memory\n"
        "rise = memory.rise_mb(lambda: np.ones(8_000_000).sum())\n"
        "assert 50 < rise < 100 and memory.highest_mb() > rise, rise"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_beams_are_left_out_without_poses() -> None:
    walk = PlazaWalk(Plaza(), steps=2)
    thinned = recordings.FewerBeams(walk, 8)
    few, all_points = thinned.scan(0), walk.scan(0)
    assert thinned.poses is None and few.T_odom_sensor is None and len(thinned) == 2
    assert 0 < len(few) < len(all_points) / 2 and thinned.name == "plaza, 8 beams"
    assert recordings.Unposed(walk).poses is None


@pytest.mark.parametrize(("name", "queries"), [("accumulated", 179), ("sparse", 179)])
def test_protocols_are_those_of_the_shell_script(kitti: Path, name: str, queries: int) -> None:
    query_set = kitti00.query_set(kitti, name)
    assert query_set.truths is not None and len(query_set.positions) == queries
    assert (query_set.recording.poses is None) == (name == "sparse")
    step = kitti00.query_set(kitti, name, 10)
    np.testing.assert_array_equal(step.positions, query_set.positions[::10])
    script = Path(kitti00.__file__).parent / "protocols" / "kitti00.sh"
    text = script.read_text("utf-8")
    for part in (kitti00.FIRST_HALF, kitti00.SECOND_HALF, kitti00.LATER_PASSES):
        assert f"--select {part}" in text
