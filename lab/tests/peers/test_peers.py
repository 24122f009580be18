"""The peers that segloc is compared with: a comparison is worth what its rivals are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from segloc_lab.peers.compare import score, scored, summary, table
from segloc_lab.peers.exchange import Answers, Clouds, Gathering
from segloc_lab.peers.scan_context import ScanContexts, sideways

from segloc import geometry


def street(seed: int) -> NDArray[np.float32]:
    """A flat piece of ground with posts of random height on it."""
    rng = np.random.default_rng(seed)
    ground = np.c_[rng.uniform(-60, 60, (4000, 2)), np.full(4000, -1.7)]
    posts = [
        np.c_[rng.normal(at, 0.2, (40, 2)), rng.uniform(-1.7, rng.uniform(1, 8), 40)]
        for at in rng.uniform(-50, 50, (60, 2))
    ]
    return np.concatenate([ground, *posts]).astype(np.float32)


def places() -> Clouds:
    found = Gathering()
    for seed in range(4):
        found.add(street(seed), geometry.yaw_transform(seed, (100.0 * seed, 0.0, 0.0)))
    return found.clouds()


@pytest.mark.parametrize("degrees", [0, 30, 90, 180, -78])
def test_scan_context_finds_place_and_turn(degrees: float) -> None:
    views = places()
    turned = geometry.yaw_transform(np.radians(degrees), (0.0, 0.0, 0.0))
    query = geometry.transform(turned, views[2]).astype(np.float32)
    best = ScanContexts(views, 80.0).candidates(query, sideways([0.0]), 3)[0]
    assert best.view == 2
    np.testing.assert_allclose(
        best.T_map_query, views.poses[2] @ geometry.inverse(turned), atol=1e-6
    )


def test_shifted_scan_context_undoes_a_step_aside() -> None:
    views = places()
    aside = geometry.yaw_transform(0.0, (0.0, 10.0, 0.0))
    query = geometry.transform(geometry.inverse(aside), views[1]).astype(np.float32)
    best = ScanContexts(views, 80.0).candidates(query, sideways([-10.0, 0.0, 10.0]), 1)[0]
    assert best.view == 1
    np.testing.assert_allclose(best.T_map_query, views.poses[1] @ aside, atol=1e-6)


def test_threshold_is_the_best_wrong_answer(tmp_path: Path) -> None:
    queries = places()
    answers = Answers(len(queries))
    for q, (wrong, value) in enumerate([(False, 0.9), (True, 0.6), (False, 0.5), (False, 0.7)]):
        T = queries.poses[q].copy()
        T[0, 3] += 4.0 if wrong else 1.0
        with answers.timed(q):
            answers.give(q, T, value)
    answers.save(tmp_path, "peer")
    queries.save(tmp_path / "queries.npz")
    result = score(tmp_path / "answers-peer.npz", Clouds.load(tmp_path / "queries.npz"))
    assert result.threshold == 0.6
    assert result.taken.tolist() == [True, False, False, True]
    assert result.right.tolist() == [True, False, True, True]
    columns, ((name, queries, right, *rest),) = table(scored(tmp_path))
    assert columns[2] == "all" and (name, queries, right) == ("peer", 4, "2 of 4")
    assert rest[:-1] == [0, "3 of 4", "0.6"]
    assert summary([scored(tmp_path)]) == [("peer", 1, "2 of 4", "2 of 4")]
