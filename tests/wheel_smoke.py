"""Run by ``make wheel-check`` in an environment that holds the wheel and nothing else."""

from __future__ import annotations

import sys

import numpy as np

import segloc
from segloc import Localizer, Scan, SegmentMap
from segloc.descriptors import create

methods = ("profile", "geo", "dsm", "dsm-fq", "segmatch-esf", "nsm")
for name in methods:
    create(name)
prior_map = SegmentMap.empty("dsm", create("dsm").fingerprint, create("dsm").dim)
result = Localizer(prior_map).localize(Scan(np.random.default_rng(0).normal(0, 10, (5000, 3))))
assert not result.localized and result.T_map_sensor is None and result.reason
for heavy in ("torch", "matplotlib", "trimesh", "rclpy", "open3d"):
    assert heavy not in sys.modules, heavy
print(f"segloc {segloc.__version__}: {', '.join(methods)}")
