"""Separation of matching and different segments by each method (Fig. 5 of the paper)."""

from __future__ import annotations

import time

import numpy as np

from ...evaluation.study import Cell, Figure, Study, Table
from .pairs import Roc
from .published import GENERALIZATION, METHODS
from .transfer import TITLES, Plan, Transfer
from .workspace import Workspace

NAME = "roc"
Curves = dict[str, dict[str, Roc]]

_STRICT = 0.01
_SCORED = ("dsm", "esm", "profile")

_TEXT = """\
Two segments of different sessions either show one object or two. Each method gives such a pair a \
score; the receiver operating characteristic shows which share of the matching pairs lies above a \
threshold, against the share of the others that does, for all thresholds. The area below it is the \
chance that a random matching pair scores above a random other one.

Every method was trained on the surroundings that it is tested in, in other places, for a few \
minutes only: the methods are as good here as they get in that time."""


def run(workspace: Workspace, plan: Plan | None = None) -> Study:
    """Draw ROC curves of all methods, each trained and tested on one domain.

    Parameters
    ----------
    plan : Plan, optional
        By default that of the workspace's scale.
    """
    start = time.monotonic()
    transfer = Transfer(workspace, plan)
    domains = transfer.domains.names
    transfer.prepare(domains)
    scored = [method for method in _SCORED if method in transfer.methods]
    found = transfer.curves([(domain, domain) for domain in domains], scored)
    curves: Curves = {domain: each for (domain, _), each in found.items()}
    tables = (_areas(transfer, curves), _published(), _details(curves), _judges(transfer, curves))
    figures = tuple(_figure(domain, found) for domain, found in curves.items())
    facts = workspace.facts(time.monotonic() - start, transfer.fingerprints)
    facts["steps"] = dict(transfer.plan.effort.steps)
    return Study(NAME, "Telling objects apart", tables, figures, facts, _TEXT)


def _figure(domain: str, curves: dict[str, Roc]) -> Figure:
    series = {
        f"{method} ({curve.area.value:.3f})": (curve.false_positive, curve.true_positive)
        for method, curve in curves.items()
    }
    return Figure(
        f"roc_{domain}", TITLES[domain], "roc", series, "false positive rate", "true positive rate"
    )


def _areas(transfer: Transfer, curves: Curves) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (method, *(_area(found.get(method)) for found in curves.values()))
        for method in transfer.methods
    ]
    counts = [f"{int(transfer.pairs(domain).same.sum())} of {TITLES[domain]}" for domain in curves]
    note = (
        "A pair matches if its centroids lie within 0.5 m, and does not beyond 20 m, as in the "
        "paper. Scores: minus the distance of descriptors; the probability of the forest "
        "(SegMatch, NSM) or of FC4 (-fq). Matching pairs, and as many others: "
        + ", ".join(counts)
        + "."
    )
    columns = ("method", *(TITLES[domain] for domain in curves))
    return Table("roc", "Area under the curve", columns, tuple(rows), note)


def _area(curve: Roc | None) -> Cell:
    return None if curve is None else round(curve.area.value, 4)


def _details(curves: Curves) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for domain, found in curves.items():
        for method, curve in found.items():
            strict = float(np.interp(_STRICT, curve.false_positive, curve.true_positive))
            interval = f"{curve.area.low:.3f} to {curve.area.high:.3f}"
            rows.append((TITLES[domain], method, _area(curve), interval, round(strict, 3)))
    columns = ("set", "method", "area", "95 %", "found at 1 % false")
    note = (
        "Intervals by bootstrap over places. Found: share of the matching pairs above the "
        "threshold that 1 % of the others pass."
    )
    return Table("roc_details", "The curves in figures", columns, tuple(rows), note)


def _judges(transfer: Transfer, curves: Curves) -> Table:
    """Compare distance with learned scores of pairs."""
    rows: list[tuple[Cell, ...]] = []
    for domain, found in curves.items():
        for method in (m for m in _SCORED if m in transfer.methods):
            trust = transfer.trust(method, domain, domain)
            each = (found.get(method), found.get(f"{method}-fq"), trust)
            rows.append((TITLES[domain], method, *map(_area, each)))
    columns = ("set", "method", "distance", "FC4", "distance and quality")
    note = (
        "Areas by score of a pair. FC4 is what the paper calls feature quality. The quality "
        "that localization orders its matches by rates a single segment: whether the nearest one "
        "in a map will be of the same object. It is a poor measure of given pairs."
    )
    return Table("roc_judges", "What judges a pair", columns, tuple(rows), note)


def _published() -> Table:
    own = [(test, areas) for test, train, areas in GENERALIZATION if test == train]
    rows: list[tuple[Cell, ...]] = [
        (method, *(areas[k] for _, areas in own)) for k, method in enumerate(METHODS)
    ]
    columns = ("method", "KITTI", "Burgess Field", "RobotCar")
    note = "From Table I, training and test set alike. Other recordings: compare ranks, not values."
    return Table("roc-paper", "Area under the curve", columns, tuple(rows), note, "paper")
