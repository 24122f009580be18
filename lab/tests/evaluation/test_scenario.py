"""What answers are kept for: two recordings as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from samples.plaza import Plaza, PlazaSequence
from samples.walk import as_folder
from segloc_lab.evaluation.scenario import Pair, PairScenario

from segloc.tools.io import Trajectory, write_tum


def test_a_correction_that_keeps_sizes_makes_another_recording(tmp_path: Path) -> None:
    walk = PlazaSequence(Plaza(0), steps=4)
    one, other = (as_folder(tmp_path / name, walk) for name in ("map", "query"))
    truth = tmp_path / "truth.tum"

    def settings(side: float) -> dict[str, Any]:
        poses = walk.poses.copy()
        poses[:, 1, 3] *= side
        write_tum(truth, Trajectory(np.arange(4.0), poses))
        return PairScenario(Pair(one, other, truth=truth, every_m=0.5)).settings()

    before = settings(1.0)
    assert settings(1.0) == before
    assert settings(-1.0)["truths"] != before["truths"]
    np.save(one / "0000.npy", np.load(one / "0000.npy") * np.float32(0.5))
    assert settings(1.0)["files"] != before["files"]
