"""Timing: every stage of every method, on the same segments."""

from __future__ import annotations

import numpy as np
import pytest
from segloc_lab.stages import STAGES
from segloc_lab.studies.paper import timing

from segloc.descriptors import create
from segloc.frontend.segmentation import Segmenter
from segloc.map.segment_map import SegmentMap
from segloc.types import LocalCloud


def test_every_stage_of_every_method_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a map of one cloud of boxes, with that cloud as its query."""
    rng = np.random.default_rng(0)
    boxes = [
        rng.uniform(0, 1, (400, 3)) * [2, 1, 3] + [*rng.uniform(-30, 30, 2), 0.2] for _ in range(20)
    ]
    ground = np.column_stack([rng.uniform(-40, 40, (20_000, 2)), rng.normal(0, 0.02, 20_000)])
    points = np.concatenate([*boxes, ground]).astype(np.float32)
    cloud = LocalCloud(points, np.eye(4), num_scans=2)
    scene = Segmenter().segment(cloud)
    maps = {}
    for name in ("geo", "nsm", "esm"):
        descriptor = create(name, 1)
        maps[name] = SegmentMap.empty(name, descriptor.fingerprint, descriptor.dim)
        maps[name].add(
            descriptor.describe(scene.segments),
            scene.segments.centroids,
            scene.segments.sizes,
            session=0,
            stamp=0.0,
            cloud=scene.surface if name == "geo" else np.empty((0, 3)),
        )
    monkeypatch.setattr(timing, "MAP_SEGMENTS", 500)
    times = timing.stage_times(maps, [cloud], 1, 1)
    assert set(times) == {"geo", "nsm", "esm"}
    for stages in times.values():
        assert set(STAGES) < set(stages) and all(ms >= 0 for ms in stages.values())
    assert len({stages["segmentation"] for stages in times.values()}) == 1
    assert times["nsm"]["pruning"] > times["geo"]["pruning"]
    assert times["esm"]["descriptor"] > times["geo"]["descriptor"]
