"""Descriptors without the pipeline: ROC areas, and recall in pools of any size.

    python -m segloc_lab.protocols.descriptor_scores DATASET --methods profile geo dsm

Every session of the dataset is searched among all others. With ``--pool`` the table gives recall
among the 25 nearest where segments of the ``--distractors`` fill the pool up to each of these
sizes; without, recall among the 1, 5, 25 and 200 nearest of the dataset. A method is the name of a
descriptor or a file of weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..report import Cell, Table, publish, reporting
from ..training.dataset import SegmentDataset
from ..training.metrics import KS, Report, load_descriptor, score_descriptor
from ..training.shards import load_dataset

AMONG = 25
"""Numbers of nearest neighbours in tables of pools."""


def by_rank(reports: dict[str, Report]) -> tuple[tuple[str, ...], list[tuple[Cell, ...]]]:
    """Return columns and rows: the area, and recall among k nearest."""
    columns = ("method", "area under the ROC (95 %)", *(f"recall at {k}" for k in KS))
    rows: list[tuple[Cell, ...]] = [
        (name, str(report.auc), *(round(float(r), 3) for r in report.recalls[0][1]))
        for name, report in reports.items()
    ]
    return columns, rows


def by_pool(reports: dict[str, Report]) -> tuple[tuple[str, ...], list[tuple[Cell, ...]]]:
    """Return columns and rows: recall among :data:`AMONG` in pools of each size."""
    sizes = [size for size, _ in next(iter(reports.values())).recalls]
    columns = ("method", *(f"{size} segments" for size in sizes))
    k = KS.index(AMONG)
    rows: list[tuple[Cell, ...]] = [
        (name, *(round(float(found[k]), 3) for _, found in report.recalls))
        for name, report in reports.items()
    ]
    return columns, rows


def scored(
    names: Sequence[str],
    dataset: SegmentDataset,
    distractors: Sequence[SegmentDataset],
    pools: Sequence[int],
) -> dict[str, Report]:
    """Return each descriptor by its name, or by its file's name."""
    return {
        Path(name).stem: score_descriptor(
            load_descriptor(name, 1), dataset, distractors, pools=pools
        )
        for name in names
    }


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("dataset", type=Path)
    options.add_argument("--methods", nargs="+", default=["profile", "geo", "dsm", "esm"])
    options.add_argument("--distractors", type=Path, nargs="*", default=[])
    options.add_argument("--pool", type=int, nargs="*", default=[], help="sizes")
    given = options.parse_args()
    others = [load_dataset(path) for path in given.distractors]
    reports = scored(given.methods, load_dataset(given.dataset), others, given.pool)
    columns, rows = by_pool(reports) if given.pool else by_rank(reports)
    queries = next(iter(reports.values())).queries
    note = f"{queries} queries, each of a session among all others."
    publish(given.report, f"Descriptors on {given.dataset.name}", Table(columns, rows, note))


if __name__ == "__main__":
    main()
