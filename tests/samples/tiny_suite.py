"""A test set that is small enough to be driven within a test."""

from __future__ import annotations

from segloc_lab.simulation.suites import LATER, TestSet

TINY = TestSet(
    "tiny", "City park", "park", "vlp16", 90, 9, (LATER,),
    spacing_m=5.0, size_m={"small": 150, "full": 150}, share={"small": 1.0, "full": 1.0},
)  # fmt: skip
