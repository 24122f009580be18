"""How well each method tells segments of one object from those of two (Fig. 5 of the paper)."""

from __future__ import annotations

import time

import numpy as np

from .pairs import Roc
from .published import GENERALIZATION, METHODS
from .study import Cell, Figure, Study, Table
from .transfer import TITLES, Plan, Transfer
from .workspace import Workspace

NAME = "roc"
_STRICT = 0.01
_JUDGED = ("dsm", "esm", "profile")

_TEXT = """\
Two segments of different sessions either show one object or two. Each method gives such a pair a \
score; the receiver operating characteristic shows which share of the matching pairs lies above a \
threshold, against the share of the others that does, for all thresholds. The area below it is the \
chance that a random matching pair scores above a random other one.

Every method was trained on the surroundings that it is tested in, in other places, for a few \
minutes only: the methods are as good here as they get in that time."""


def run(workspace: Workspace, plan: Plan | None = None) -> Study:
    """ROC curves of all methods, each trained and tested on one domain.

    Parameters
    ----------
    workspace : Workspace
    plan : Plan, optional
        By default that of the workspace's scale.
    """
    start = time.monotonic()
    transfer = Transfer(workspace, plan)
    domains = transfer.domains.names
    transfer.prepare(domains)
    curves: dict[str, dict[str, Roc]] = {domain: {} for domain in domains}
    with workspace.progress("Scoring pairs") as update:
        for done, (domain, method) in enumerate(cells := _cells(transfer, domains)):
            update(done, len(cells))
            curve = transfer.curve(method, domain, domain)
            if curve is not None:
                curves[domain][method] = curve
    tables = (_areas(transfer, curves), _judges(transfer, curves), _published())
    figures = tuple(_figure(domain, found) for domain, found in curves.items())
    facts = workspace.facts(time.monotonic() - start, transfer.fingerprints)
    facts["steps"] = dict(transfer.plan.effort.steps)
    return Study(NAME, "Telling objects apart", tables, figures, facts, _TEXT)


def _cells(transfer: Transfer, domains: tuple[str, ...]) -> list[tuple[str, str]]:
    return [(domain, method) for domain in domains for method in transfer.methods]


def _figure(domain: str, curves: dict[str, Roc]) -> Figure:
    series = {
        f"{method} ({curve.area.value:.3f})": (curve.false_positive, curve.true_positive)
        for method, curve in curves.items()
    }
    return Figure(
        f"roc_{domain}", TITLES[domain], "roc", series, "false positive rate", "true positive rate"
    )


def _areas(transfer: Transfer, curves: dict[str, dict[str, Roc]]) -> Table:
    columns = ["method"]
    for domain in curves:
        columns += [TITLES[domain], "95 %", "at 1 % false"]
    rows = []
    for method in transfer.methods:
        row: list[Cell] = [method]
        for found in curves.values():
            row += _described(found[method]) if method in found else [None] * 3
        rows.append(tuple(row))
    counts = [f"{TITLES[domain]} {int(transfer.pairs(domain).same.sum())}" for domain in curves]
    note = (
        "Area under the curve, its 95 % interval by bootstrap over places, and the share of the "
        "matching pairs found where 1 % of the others pass. A pair matches if centroids lie within "
        "0.5 m, and does not beyond 20 m, as in the paper. Scores: minus the distance of "
        "descriptors; the probability of the forest (SegMatch, NSM) or of FC4 (-fq). "
        f"Matching pairs, and as many others: {', '.join(counts)}."
    )
    return Table("roc_areas", "Areas under the curves", tuple(columns), tuple(rows), note)


def _described(curve: Roc) -> list[Cell]:
    area = curve.area
    strict = float(np.interp(_STRICT, curve.false_positive, curve.true_positive))
    return [round(area.value, 4), f"{area.low:.3f} to {area.high:.3f}", round(strict, 3)]


def _judges(transfer: Transfer, curves: dict[str, dict[str, Roc]]) -> Table:
    """Distance against what was learned to judge it."""
    rows: list[tuple[Cell, ...]] = []
    for method in (m for m in _JUDGED if m in transfer.methods):
        row: list[Cell] = [method]
        for domain, found in curves.items():
            trust = transfer.trust(method, domain, domain)
            each = (found.get(method), found.get(f"{method}-fq"), trust)
            row += [None if curve is None else round(curve.area.value, 4) for curve in each]
        rows.append(tuple(row))
    columns = ["method"]
    for domain in curves:
        columns += [f"{TITLES[domain]}: distance", "FC4", "distance and quality"]
    note = (
        "FC4 judges a pair; it is what the paper calls feature quality. The quality that "
        "localization orders its matches by judges a single segment: whether the nearest one in a "
        "map will be of the same object. Of pairs that are given it says little."
    )
    return Table("roc_judges", "Areas by what judges a pair", tuple(columns), tuple(rows), note)


def _published() -> Table:
    own = [(test, areas) for test, train, areas in GENERALIZATION if test == train]
    rows: list[tuple[Cell, ...]] = [
        (method, *(areas[k] for _, areas in own)) for k, method in enumerate(METHODS)
    ]
    columns = ("method", "KITTI", "Burgess Field", "RobotCar")
    note = "From Table I, training and test set alike. Other recordings: compare ranks, not values."
    return Table("roc-paper", "Published areas", columns, tuple(rows), note, "paper")
