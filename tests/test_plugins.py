"""Parts of other packages that break their contract are named, in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, ConfigError, Localizer, SeglocError, SegmentMap, build_map, geometry
from segloc.descriptors import base, create
from segloc.descriptors.base import Descriptor
from segloc.types import Candidate, Descriptors, Segments


class Sizes(Descriptor):
    name, dim, fingerprint = "sizes", 1, "1"

    def __init__(self, threads: int = 0) -> None:
        pass

    def encode(self, prepared: Segments) -> Descriptors:
        return Descriptors(prepared.sizes[:, None].astype(np.float32))


class Unnamed(Sizes):
    name = "other"


class Rows(Sizes):
    def encode(self, prepared: Segments) -> Any:
        return prepared.sizes[:, None].astype(np.float32)


class NoDescriptor:
    name, dim = "sizes", 1

    def __init__(self, threads: int = 0) -> None:
        pass


@pytest.fixture(autouse=True)
def entries(monkeypatch: pytest.MonkeyPatch) -> None:
    base.available()
    monkeypatch.setattr(base, "_entries", dict(base._entries))


@pytest.mark.parametrize(
    ("kind", "fault"),
    [(Unnamed, "'sizes' calls itself 'other'"), (NoDescriptor, "has no fingerprint, encode")],
)
def test_what_is_no_descriptor_of_its_name(kind: Any, fault: str) -> None:
    base.register("sizes")(kind)
    with pytest.raises(ConfigError, match=fault):
        create("sizes")


def test_a_descriptor_that_gives_something_else(plaza: Plaza) -> None:
    base.register("sizes")(Rows)
    with pytest.raises(SeglocError, match="gave ndarray, not Descriptors"):
        build_map(PlazaSequence(plaza, steps=2), Config(method="sizes"))


@pytest.mark.parametrize("proposed", [np.eye(4), Candidate(np.full((4, 4), np.nan), 0)])
def test_a_proposer_that_proposes_something_else(
    proposed: Any, plaza: Plaza, plaza_map: SegmentMap
) -> None:
    class Guess:
        name = "guess"

        def propose(self, *_: Any) -> Any:
            return [proposed]

    localizer = Localizer(plaza_map, proposers=[Guess()])
    away = plaza.scan(geometry.yaw_transform(1.0, (60.0, 60.0, 1.7)))
    with pytest.raises(ConfigError, match="proposer 'guess' must return candidates"):
        localizer.localize(away)
