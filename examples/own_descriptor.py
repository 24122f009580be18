"""A descriptor of your own, in the whole pipeline: register it, build a map with it, localize.

In the package a descriptor is one such file in ``src/segloc/descriptors/``.

    python examples/own_descriptor.py
"""

from __future__ import annotations

import numpy as np
from segloc_lab.simulation import Conditions, hdl64e, simulate_sessions, town

from segloc import Config, Localizer, build_map
from segloc.descriptors.base import Descriptor, register
from segloc.types import Descriptors, Segments


@register("boxes", preset={"matching": {"neighbours": 50}})
class BoxDescriptor(Descriptor):
    """Height, logarithm of the horizontal spread, and height above the ground."""

    name = "boxes"
    dim = 3
    fingerprint = "boxes-1"  # change it with the numbers: maps and queries must agree

    def __init__(self, threads: int = 0) -> None:
        del threads

    def encode(self, segments: Segments) -> Descriptors:
        """(P, 3) vectors, compared by Euclidean distance."""
        rows = [self._numbers(segments.segment(k)) for k in range(len(segments))]
        numbers = np.array(rows, dtype=np.float32).reshape(-1, 2)
        return Descriptors(np.column_stack([numbers, segments.heights]).astype(np.float32))

    @staticmethod
    def _numbers(points: np.ndarray) -> tuple[float, float]:
        return float(np.ptp(points[:, 2])), float(np.log(points[:, :2].std() + 0.05))


def main() -> None:
    first, second = simulate_sessions(
        town(7, size_m=150.0), hdl64e(600), [Conditions()] * 2, length_m=80.0
    )
    config = Config.preset("boxes")
    localizer = Localizer(build_map(first, config), config)
    results = [localizer.localize(second.scan(i)) for i in range(0, len(second), 5)]
    print(f"found {sum(r.localized for r in results)} of {len(results)}")


if __name__ == "__main__":
    main()
