"""Cost and benefit of farthest-point sampling (section Sampling of the paper)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from segloc.descriptors.pointset import load_weights
from segloc.types import Float32

from ...bench.fps import SAMPLES, SEGMENTS, fps
from ...bench.harness import OURS, Row, in_process
from ...evaluation.study import Cell, Study, Table
from ...training.config import Sampler
from ...training.dataset import SegmentDataset, chunks
from ...training.metrics import score
from .domains import Domains, DomainSize
from .learning import network_config, trained_dsm
from .pairs import Described, labelled_pairs, pair_scores, roc
from .workspace import Workspace

NAME = "sampling"
DOMAIN = "kitti"
NAIVE = "NumPy, a segment at a time"
K = 25

_SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)
_TEXT = """\
DSM keeps ever fewer points of a segment from layer to layer. Which points it keeps, a sampler \
decides: the farthest from those it has, random ones, or rather those where points are sparse. The \
same network is trained with each.

Farthest-point sampling is the slowest of the three. The paper reports that sampling all segments \
as one tensor is 80 times as fast as sampling one after another. How much of that is the tensor, \
and how much the code, shows where all samplers are timed in turns on the same segments."""


@dataclass(frozen=True)
class Plan:
    """Amounts of timing and training.

    Attributes
    ----------
    repeats : int
        Of each sampler; the median counts.
    steps : int
        Of each of the three trainings.
    segments : int
        Of the test set at most, whole objects.
    pairs : int
        Of each kind for the area under the ROC.
    """

    repeats: int
    steps: int
    segments: int
    pairs: int
    sizes: Mapping[str, DomainSize] | None = None


PLANS = {"small": Plan(5, 300, 8_000, 2_000), "full": Plan(15, 1500, 40_000, 10_000)}
"""By scale: two minutes of one core and four for the trainings."""


def run(workspace: Workspace, plan: Plan | None = None) -> Study:
    """Time the samplers, and train DSM with each sampler.

    Parameters
    ----------
    plan : Plan, optional
        By default that of the workspace's scale.
    """
    start = time.monotonic()
    plan = plan or PLANS[workspace.effort]
    with workspace.progress("Timing samplers") as update:
        update(0, 1)
        measured = in_process(1, fps, 1, plan.repeats)
    domains = Domains(workspace, plan.sizes)
    rows, fingerprints = _rows(workspace, domains, plan)
    facts = workspace.facts(time.monotonic() - start, fingerprints) | {"steps": plan.steps}
    tables = (_speeds(measured), _worth(rows, plan))
    return Study(NAME, "Sampling points", tables, (), facts, _TEXT)


def _speeds(measured: Row) -> Table:
    """Compare every sampler's time with the loop over segments."""
    times = {f"{OURS}, this processor's best": measured.ours_ms, **measured.rivals}
    naive = measured.rivals[NAIVE]
    rows: list[tuple[Cell, ...]] = [
        (name, round(ms, 2), round(naive / ms, 1), round(ms / measured.ours_ms, 1))
        for name, ms in sorted(times.items(), key=lambda item: item[1])
    ]
    skipped = f" Not installed: {', '.join(measured.skipped)}." if measured.skipped else ""
    note = (
        f"{SEGMENTS} segments of 256 points, {SAMPLES} samples of each; one thread, medians of "
        "runs in turns. All take the farthest point at every step. The paper reports a factor of "
        f"80 for its batched tensor over a segment at a time.{skipped}"
    )
    columns = ("sampler", "ms", "times as fast as a segment at a time", "times our time")
    return Table("sampling_speed", "Farthest-point sampling", columns, tuple(rows), note)


def _rows(
    workspace: Workspace, domains: Domains, plan: Plan
) -> tuple[list[tuple[Cell, ...]], dict[str, str]]:
    settings = [{"sampler": sampler} for sampler in _SAMPLERS]
    weights = trained_dsm(workspace, domains.folder(DOMAIN, "train"), plan.steps, settings)
    dataset = domains.dataset(DOMAIN, "test").limited(plan.segments, workspace.seed)
    pairs = labelled_pairs(dataset, limit=plan.pairs, seed=workspace.seed)
    rows: list[tuple[Cell, ...]] = []
    fingerprints = {}
    for sampler, path in zip(_SAMPLERS, weights, strict=True):
        vectors = sampled_vectors(path, dataset, sampler)
        found = Described(vectors, None, pairs.first, pairs.second)
        area = roc(pair_scores(found), pairs, seed=workspace.seed).area
        recall = score(vectors, dataset, k=K).recall or 0.0
        interval = f"{area.low:.3f} to {area.high:.3f}"
        name = sampler.replace("_", " ")
        rows.append((name, round(area.value, 4), interval, round(recall, 4)))
        fingerprints[f"dsm, {name}"] = load_weights(path).sha256[:16]
    return rows, fingerprints


def sampled_vectors(weights: Path, dataset: SegmentDataset, sampler: Sampler) -> Float32:
    """Describe all segments (P, 16), with points in the sampler's order.

    The descriptors of the package always take the farthest points.
    """
    from ...training.pointset import prepared_points

    network = load_weights(weights).network
    config = network_config("dsm", 1, sampler=sampler)
    parts = [np.empty((0, network.dim), np.float32)]
    for indices in chunks(len(dataset), 1024):
        parts.append(network.describe(prepared_points(dataset, indices, config), 1)[0])
    return np.concatenate(parts)


def _worth(rows: list[tuple[Cell, ...]], plan: Plan) -> Table:
    columns = ("sampler", "area", "95 %", f"recall@{K}")
    note = (
        f"DSM after {plan.steps} steps with each sampler. Area under the ROC over pairs of "
        "segments, with its interval over places; recall: how often one of the object's views of "
        f"other sessions is among the {K} nearest. The paper reports that farthest points are "
        "best, without figures."
    )
    return Table("sampling_worth", "DSM with each sampler", columns, tuple(rows), note)
