"""The paper's protocol on KITTI 00: its parts, its counts, and that it goes on where it stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from segloc_lab.report import mcnemar, share
from segloc_lab.studies import kitti_paper as protocol
from segloc_lab.studies.kitti_paper import ESTIMATORS, VERIFIED

from segloc.tools.batch.score import distances_to_path


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
    assert protocol.threshold(training, "votes 50") == 16
    assert protocol.chosen(training, "votes", (25, 50)) == 25  # two each: the smaller
    assert protocol.outcomes(training, "votes 25", 7) == "+x--+"
    assert protocol.outcomes([{"distance": 1.0, "everything": None}], "everything") == "-"


@pytest.mark.data
def test_the_parts_are_the_papers_and_training_knows_no_query(kitti: Path) -> None:
    test, training = protocol.test_part(kitti), protocol.training_part(kitti)
    assert len(test.positions) == 133 and (test.distances <= 3.0).sum() == 49
    first = test.queried.indices[0]
    for recording in (test.mapped, training.mapped, training.queried):
        assert recording.indices[-1] < first
    assert (training.distances <= 3.0).sum() > 30 < (training.distances > 20.0).sum()


def walks(data: Path) -> protocol.Part:
    """A part made of two walks over one plaza, in place of a drive."""
    mapped, queried = PlazaSequence(Plaza(1), steps=6), PlazaSequence(Plaza(1), steps=4)
    positions = np.array([1, 3])
    distances = distances_to_path(queried.poses[positions], mapped.poses)
    return protocol.Part(mapped, queried, positions, distances)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """The protocol on two walks."""
    monkeypatch.setattr(protocol, "PARTS", {"test": walks, "training": walks})


METHODS = ("geo", "segmatch-eigen")


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_pieces_that_were_cut_off_and_put_together_are_one_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "keyframes.tum").touch()
    whole = protocol.answers_of(METHODS, tmp_path, tmp_path / "one", say=str)
    for answers in whole.values():
        outcomes = protocol.outcomes_of(answers)
        assert outcomes.keys() == {*ESTIMATORS, *VERIFIED} and set(outcomes.values()) == {"++"}
    every = protocol.queries

    def cut_off(*arguments: Any) -> Any:
        yield next(every(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(protocol, "queries", cut_off)
    with pytest.raises(KeyboardInterrupt):
        protocol.answers_of(METHODS, tmp_path, tmp_path / "two", say=str)
    monkeypatch.setattr(protocol, "queries", every)
    monkeypatch.setattr(protocol, "QUERIES", 1)  # the row that is there is a piece by now
    requested: list[str] = []
    for method in METHODS:
        protocol.answers_of((method,), tmp_path, tmp_path / "two", requested.append, workers=1)
    assert len(requested) == 8
    assert protocol.stored(tmp_path / "two") == protocol.stored(tmp_path / "one") == whole
    (counts,) = protocol.study(protocol.stored(tmp_path / "two")).tables
    assert [(name, *found[-2:]) for name, _, _, *found in counts.rows] == [
        (name, "2", "2") for name in ("segmatch-eigen", "geo")
    ]
    monkeypatch.setattr(protocol, "_measure", lambda *_: pytest.fail("measured again"))
    assert protocol.answers_of(METHODS, tmp_path, tmp_path / "two", say=str) == whole
