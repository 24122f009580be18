"""Worlds of a few types: what repeats is equal, the same seed makes the same, scans can be cast."""

from __future__ import annotations

import numpy as np
import pytest
from segloc_lab.simulation import SCENES, World

pytest.importorskip("embreex")
pytestmark = pytest.mark.slow

SIZES = {"terraces": 130.0, "forest": 100.0}


@pytest.fixture(scope="module", params=list(SIZES))
def world(request: pytest.FixtureRequest) -> World:
    return SCENES[request.param](1, size_m=SIZES[request.param], repetition=1.0)


def heights(world: World, kind: str) -> list[float]:
    """Of the objects of a kind, in centimetres, as often as there are."""
    objects = world.static
    found = []
    for number in (k for k, each in objects.kinds.items() if each == kind):
        z = objects.triangles[objects.object_ids == number][..., 2]
        found.append(round(float(np.ptp(z)), 2))
    return found


def test_things_are_of_few_types(world: World) -> None:
    kind = "lamp" if world.name.startswith("terraces") else "tree"
    tall = heights(world, kind)
    assert len(tall) > 5
    # What stands on a path is cut, and trees are drawn coarsely where nobody comes near.
    common = [tall.count(each) for each in set(tall)]
    assert sum(sorted(common)[-6:]) > 0.5 * len(tall)
