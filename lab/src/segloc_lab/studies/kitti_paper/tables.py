"""The tables of the protocol: counts beside the published ones, intervals, and who differs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from segloc.errors import DatasetError

from ...evaluation.intervals import mcnemar, share
from ...evaluation.methods import METHODS
from ...report import Table
from ..paper.published import LOCALIZATIONS
from .answers import DRAWS, ESTIMATORS, VERIFIED, verified_as
from .counting import outcomes, threshold, within_coverage

PUBLISHED_NAMES = ("segmatch-eigen", "nsm", "segmap", "esm", "dsm")
_KITTI = next(row[5] for row in LOCALIZATIONS if row[0] == "kitti")
PUBLISHED = dict(zip(PUBLISHED_NAMES, _KITTI, strict=True))
VARIANTS = (ESTIMATORS[0], VERIFIED[0], ESTIMATORS[1], VERIFIED[1], VERIFIED[2])
REFERENCE = "dsm"
_TITLES = {
    "published": "its estimator, inliers alone",
    "published, verified": "its estimator, verified",
    "votes": "votes, inliers alone",
    "votes, verified": "votes, 4K, verified",
    "everything": "the package",
}

Stored = Mapping[str, Mapping[str, Any]]


def outcomes_of(answers: Mapping[str, Any]) -> dict[str, str]:
    """A letter a query for each variant of one method; see :func:`.counting.outcomes`."""
    found = {}
    for estimator in ESTIMATORS:
        k = answers["neighbours"][estimator]
        least = threshold(answers["training"], f"{estimator} {k}")
        found[estimator] = outcomes(answers["test"], f"{estimator} {k}", least)
        if answers["verified"]:
            verified = outcomes(answers["test"], verified_as(estimator, k))
            found[f"{estimator}, verified"] = verified
    if answers["verified"]:
        found["everything"] = outcomes(answers["test"], "everything")
    return found


def draws_of(stored: Stored) -> int:
    """Samples of PROSAC at most.

    Raises
    ------
    DatasetError
        If methods differ in it.
    """
    found = {each.get("draws", DRAWS) for each in stored.values()}
    if len(found) > 1:
        raise DatasetError(f"methods were given different numbers of draws: {sorted(found)}")
    return int(found.pop())


def _ordered(stored: Stored) -> list[str]:
    return [name for name in METHODS if name in stored]


def counts(stored: Stored) -> Table:
    """Right localizations of all queries by every method and variant, and false ones."""
    rows = []
    for name in _ordered(stored):
        letters = outcomes_of(stored[name])
        cells = [_count(letters.get(variant)) for variant in VARIANTS]
        k = stored[name]["neighbours"]
        rows.append((name, PUBLISHED.get(name), f"{k['published']}, {k['votes']}", *cells))
    first = stored[_ordered(stored)[0]]["test"]
    note = (
        f"Right localizations of {len(first)} queries, {sum(within_coverage(first))} of them "
        "within 3 m of the mapped path; false ones in brackets where there are any. K: of its "
        "estimator, and of votes. Its estimator: PROSAC, also for `geo` and `profile`, which were "
        f"not published with it, of at most {draws_of(stored) / 1e6:g} million samples; for "
        "SegMatch geometric consistency. The published column has 134 clouds, other weights and "
        "other voxels."
    )
    columns = ("method", "published", "K", *(_TITLES[name] for name in VARIANTS))
    return Table(columns, rows, note, "Counts")


def _count(letters: str | None) -> str:
    if letters is None:
        return "not measured"
    false = letters.count("x")
    return f"{letters.count('+')}{f' ({false} false)' if false else ''}"


def differences(stored: Stored) -> Table:
    """What is found within coverage with intervals, and exact tests against one method."""
    rows: list[tuple[str, ...]] = []
    covered = within_coverage(next(iter(stored.values()))["test"])
    near = [k for k, flag in enumerate(covered) if flag]
    letters = {name: outcomes_of(stored[name]) for name in _ordered(stored)}
    for name in _ordered(stored):
        cells = []
        for variant in ("published", "everything"):
            if not (variant in letters[name] and variant in letters[REFERENCE]):
                cells += ["not measured", "-"]
                continue
            own, other = letters[name][variant], letters[REFERENCE][variant]
            right = [letter == "+" for letter in own]
            p = mcnemar(right, [letter == "+" for letter in other])
            cells += [
                share(sum(right[k] for k in near), len(near)),
                "-" if name == REFERENCE else f"{p:.2g}",
            ]
        rows.append((name, *cells))
    columns = (
        "method", "its estimator alone: found within coverage", f"p against {REFERENCE}",
        "the package: found within coverage", f"p against {REFERENCE}",
    )  # fmt: skip
    note = (
        "In brackets: 95 % by Wilson. p: McNemar's exact test over all queries, right or not; no "
        "correction for several tests."
    )
    return Table(columns, rows, note, "Differences")
