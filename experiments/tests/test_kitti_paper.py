"""The paper's protocol on KITTI 00: its parts, its counts, and that it goes on where it stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from segloc_experiments.intervals import mcnemar, share
from segloc_experiments.kitti_paper import counting, places, protocol, tables
from segloc_experiments.kitti_paper.answers import ESTIMATORS, VERIFIED

from segloc.batch.score import distances_to_path


def test_mcnemar_is_the_binomial_test_of_those_that_differ() -> None:
    a = [True] * 9 + [False] + [True] * 20
    b = [False] * 9 + [True] + [True] * 20
    assert mcnemar(a, b) == mcnemar(b, a) == pytest.approx(2 * 11 / 1024)  # P(X <= 1) of 10
    assert mcnemar(a, a) == 1.0
    with pytest.raises(ValueError, match="zip"):
        mcnemar(a, b[1:])
    assert share(9, 10) == "9 of 10 (60 to 98 %)" and share(0, 0) == "0 of 0"


def row(distance: float, **answers: list[float | None]) -> dict[str, Any]:
    return {"distance": distance, **{name.replace("_", " "): a for name, a in answers.items()}}


def test_k_is_that_which_finds_most_with_no_negative_accepted() -> None:
    training = [
        row(1.0, votes_25=[0.5, 1.0, 9], votes_50=[0.5, 1.0, 20]),
        row(1.0, votes_25=[9.0, 1.0, 30], votes_50=[0.5, 1.0, 12]),  # false, and right
        row(10.0, votes_25=[None, None, 0], votes_50=[300.0, 1.0, 99]),  # neither near nor beyond
        row(50.0, votes_25=[80.0, 5.0, 6], votes_50=[90.0, 5.0, 15]),
        row(25.0, votes_25=[0.5, 1.0, 40], votes_50=[0.5, 1.0, 40]),  # right, from afar
    ]
    assert counting.threshold(training, "votes 50") == 16
    assert counting.chosen(training, "votes", (25, 50)) == 25  # two each: the smaller
    assert counting.outcomes(training, "votes 25", 7) == "+x--+"
    assert counting.outcomes([{"distance": 1.0, "everything": None}], "everything") == "-"


@pytest.mark.data
def test_the_parts_are_the_papers_and_training_knows_no_query(kitti: Path) -> None:
    test, training = places.test_part(kitti), places.training_part(kitti)
    assert len(test.positions) == 133 and (test.distances <= 3.0).sum() == 49
    first = test.queried.indices[0]
    for recording in (test.mapped, training.mapped, training.queried):
        assert recording.indices[-1] < first
    assert (training.distances <= 3.0).sum() > 30 < (training.distances > 20.0).sum()


class Walks:
    """A part made of two walks over one plaza, in place of a drive."""

    def __init__(self) -> None:
        self.mapped = PlazaSequence(Plaza(1), steps=6)
        self.queried = PlazaSequence(Plaza(1), steps=4)
        self.positions = np.array([1, 3])
        self.truths = self.queried.poses[self.positions]
        self.distances = distances_to_path(self.truths, self.mapped.poses)


def test_every_variant_answers_and_nothing_is_measured_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in ("test_part", "training_part"):
        monkeypatch.setattr(protocol, part, lambda data: Walks())
    methods = ("geo", "segmatch-eigen")
    whole = protocol.queries

    def cut_off(*arguments: Any) -> Any:
        yield next(whole(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(protocol, "queries", cut_off)
    with pytest.raises(KeyboardInterrupt):
        protocol.answers_of(methods, tmp_path, tmp_path / "kept", say=str)
    monkeypatch.setattr(protocol, "queries", whole)
    said: list[str] = []
    found = protocol.answers_of(methods, tmp_path, tmp_path / "kept", say=said.append)
    assert "training: queries from 1 on" in said and "test: queries from 0 on" in said
    for answers in found.values():
        assert set(answers["neighbours"]) == set(ESTIMATORS)
        assert all(set(VERIFIED) <= set(each) for each in answers["test"])
        assert all(letters == "++" for letters in tables.outcomes_of(answers).values())
    monkeypatch.setattr(protocol, "Run", lambda *_: pytest.fail("measured again"))
    assert protocol.answers_of(methods, tmp_path, tmp_path / "kept", say=str) == found
    result = tables.counts(found, "a command")
    assert [cells[0] for cells in result.rows] == ["segmatch-eigen", "geo"]
    assert result.rows[0][1] == 41 and set(result.rows[0][3:]) == {"2"}
