"""The simulated counterparts: as many queries as published, and no place in two of them."""

from __future__ import annotations

import numpy as np
from segloc_lab.simulation.suites import REPEATED, SIX
from segloc_lab.simulation.worlds.world import Catalogue


def test_sets_share_no_world() -> None:
    """Nor does a test set share one with what it is trained on, or with a negative map."""
    taken: dict[tuple[str, int], str] = {}
    for test in (*SIX, *REPEATED):
        scene = "town" if test.scene == "terraces" else test.scene
        for use, seeds in {"tests": range(100), "training": range(500, 600)}.items():
            for seed in seeds:
                for number in (seed, seed + 10_000):
                    key = scene, test.first_seed + number
                    assert key not in taken, f"{test.name} ({use}) and {taken[key]}"
                    taken[key] = f"{test.name} ({use})"


def test_what_repeats_is_made_from_equal_randomness() -> None:
    own = np.random.default_rng(0)
    assert Catalogue(1, 0.0).source(own, "lamp") is own
    everything = Catalogue(1, 1.0, types=3)
    drawn = [everything.source(own, "lamp").random() for _ in range(60)]
    assert len(set(drawn)) == 3
    assert set(drawn).isdisjoint({everything.source(own, "bench").random() for _ in range(60)})
    assert set(drawn).isdisjoint({Catalogue(2, 1.0).source(own, "lamp").random() for _ in range(9)})
    some = [Catalogue(1, 0.5).source(own, "lamp") is own for _ in range(400)]
    assert 0.4 < np.mean(some) < 0.6
