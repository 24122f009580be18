"""A cross-section of the corpus is answered as stored, and what differs is noticed."""

from __future__ import annotations

import copy
from functools import reduce
from operator import add
from typing import Any

import numpy as np
import pytest

from golden.comparing import GROUPS, answers, check, compare, load
from golden.corpus import config, mapped, queries
from golden.records import exact
from segloc import Localizer
from segloc.likelihood import shipped_model
from segloc.likelihood.posterior import log_odds
from segloc.localization import Reason

pytest.importorskip("embreex")


@pytest.mark.slow
def test_answers_are_those_stored() -> None:
    quick = [name for name, group in GROUPS.items() if group.quick]
    compared = reduce(add, (check(name, answers(name)[0]) for name in quick))
    assert compared.same, str(compared)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["town", "offices"])
def test_the_probability_that_is_reported_is_that_of_the_thorough_search(name: str) -> None:
    localizer, apart = Localizer(mapped(name)[0], config()), list[float]()
    cap = log_odds(1.0 - shipped_model().lapse)
    for asked in queries(name):
        query = localizer.describe(asked.scans)
        one, full = (
            localizer.search(query, near=asked.near, thorough=way) for way in (False, True)
        )
        odds = [log_odds(found.posterior.confidence) for found in (one, full)]
        if max(odds) > 0.0 and odds[1] < cap - 0.01:
            apart.append(abs(odds[0] - odds[1]))
        if full.reason is None:
            assert one.reason is not Reason.NOT_IN_MAP, asked.name
    *others, most = sorted([0.0, 0.0, *apart])  # by the processor one may be aligned otherwise
    assert np.median(others) < 0.5 and max(others) < 1.0 and most < 3.0


@pytest.fixture()
def stored() -> dict[str, Any]:
    cases: dict[str, Any] = load("world-town")["cases"]
    return cases


def test_a_bit_that_differs_is_named_and_elsewhere_forgiven(stored: dict[str, Any]) -> None:
    found = copy.deepcopy(stored)
    T = np.eye(4)
    found["single 0"]["T_map_sensor"] = exact(np.nextafter(T, 2.0))
    found["single 9"]["confidence"] = float(np.nextafter(found["single 9"]["confidence"], 0.0))
    named = [(d.case, d.field) for d in compare(stored, found, True).differences]
    assert named == [("single 0", "T_map_sensor"), ("single 9", "confidence")]
    assert exact(T) != exact(np.nextafter(T, 2.0))
    loose = compare(stored, found, False)
    assert not loose.off and loose.same and loose.loose == len(stored) and loose.exact == 0


def test_other_poses_and_missing_cases_are_noticed_anywhere(stored: dict[str, Any]) -> None:
    found = copy.deepcopy(stored)
    del found["near"]
    found["single 0"]["pose"][0] += 0.06
    found["single 9"]["pose"][5] += 0.4
    compared = compare(stored, found, False)
    named = [(d.case, d.field) for d in compared.differences + compared.off]
    assert named == [("near", "case"), ("single 0", "pose"), ("single 9", "pose")]
    alike = compare(stored, stored, False)
    compared.differences.clear()
    assert not compared.same and (compared + alike + alike + alike).same
