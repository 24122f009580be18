"""Change of descriptors of turned segments (Fig. 6 of the paper)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np

from segloc.descriptors import create
from segloc.descriptors.base import Descriptor
from segloc.descriptors.pointset import Alignment
from segloc.geometry import yaw_transform
from segloc.types import Float32, Float64, Segments

from ...evaluation.study import Cell, Figure, Study, Table
from ...training.config import AugmentConfig
from .domains import Domains, DomainSize
from .learning import load_method, trained_dsm
from .pairs import described, labelled_pairs, pair_scores, roc
from .workspace import Workspace

NAME = "rotation"
DOMAIN = "kitti"
DEGREES = np.arange(0.0, 361.0, 10.0)

_ALIGNMENTS: tuple[Alignment, ...] = get_args(Alignment)
_UNTRAINED = ("profile", "geo")
_WORDS = {"none": "no alignment", "pca2d": "2D alignment", "pca3d": "3D alignment"}
_TEXT = """\
A robot comes back from another side, and sees the same segment turned. Segments are turned about \
the vertical by up to 360 degrees; the distance of each turned one's descriptor from that of the \
unturned one is divided by the mean distance between the descriptors of different segments. So 0 \
is a descriptor that does not change at all, and 1 one that changes as if it were of another \
segment.

DSM is trained with and without random turns of the training segments, and with three ways to \
prepare a segment: none, its principal axes in the plane turned to the axes of the frame, and its \
principal axes in space."""


@dataclass(frozen=True)
class Plan:
    """Amounts of training and turning.

    Attributes
    ----------
    steps : int
        Of each of the six trainings.
    segments : int
        That are turned.
    pairs : int
        Of each kind for the area under the ROC.
    """

    steps: int
    segments: int
    pairs: int
    sizes: Mapping[str, DomainSize] | None = None


PLANS = {"small": Plan(250, 300, 2_000), "full": Plan(1500, 1000, 10_000)}
"""By scale: three minutes of one core and ten for the trainings."""


def turned(segments: Segments, degrees: float) -> Segments:
    """Turn segments about the vertical axis through the origin."""
    turn = yaw_transform(np.radians(degrees))[:3, :3]
    points = (segments.points.astype(np.float64) @ turn.T).astype(np.float32)
    return Segments(points, segments.offsets, segments.centroids @ turn.T, segments.heights)


def deviation(describe: Callable[[Segments], Float32], segments: Segments) -> Float64:
    """Return delta = d(c_n, c_0) / Z of every segment at every angle n of :data:`DEGREES`, (A, P).

    ``c_n`` is the descriptor of the segment turned by n degrees, and Z the mean distance between
    the descriptors of all pairs of different segments (section Rotation Variation).

    Parameters
    ----------
    describe : callable
        Segments to vectors (P, dim).
    segments : Segments
        At least two.
    """
    still = describe(segments).astype(np.float64)
    scale = _mean_distance(still)
    return np.stack(
        [
            np.linalg.norm(describe(turned(segments, float(angle))) - still, axis=1) / scale
            for angle in DEGREES
        ]
    )


def _mean_distance(vectors: Float64) -> float:
    sums = [np.linalg.norm(vectors - vector, axis=1).sum() for vector in vectors]
    return float(np.sum(sums) / (len(vectors) * (len(vectors) - 1)))


def run(workspace: Workspace, plan: Plan | None = None) -> Study:
    """Turn segments under DSM with and without augmentation and alignment.

    Parameters
    ----------
    plan : Plan, optional
        By default that of the workspace's scale.
    """
    start = time.monotonic()
    plan = plan or PLANS[workspace.effort]
    domains = Domains(workspace, plan.sizes)
    descriptors = _trained(workspace, domains, plan)
    dataset = domains.dataset(DOMAIN, "test")
    rng = np.random.default_rng(workspace.seed)
    some = np.sort(rng.permutation(len(dataset))[: plan.segments])
    segments = dataset.segments(some)
    pairs = labelled_pairs(dataset, limit=plan.pairs, seed=workspace.seed)
    found: dict[str, Float64] = {}
    rows: list[tuple[Cell, ...]] = []
    with workspace.progress("Turning segments") as update:
        for done, (name, descriptor) in enumerate(descriptors.items()):
            update(done, len(descriptors))
            found[name] = deviation(lambda s, d=descriptor: d.describe(s).vectors, segments)  # type: ignore[misc]
            area = roc(pair_scores(described(descriptor, dataset, pairs)), pairs).area
            rows.append((name, *_summary(found[name]), round(area.value, 4)))
    fingerprints = {name: d.fingerprint for name, d in descriptors.items()}
    facts = workspace.facts(time.monotonic() - start, fingerprints)
    facts |= {"steps": plan.steps, "segments": len(some)}
    figures = tuple(_figure(found, augmented) for augmented in (False, True))
    return Study(NAME, "Turning a segment", (_table(rows, plan),), figures, facts, _TEXT)


def _name(alignment: Alignment, augmented: bool) -> str:
    return f"dsm, {_WORDS[alignment]}{', augmented' if augmented else ''}"


def _trained(workspace: Workspace, domains: Domains, plan: Plan) -> dict[str, Descriptor]:
    """Return the six trained methods, and ours as shipped."""
    variants = [(alignment, yaw) for yaw in (False, True) for alignment in _ALIGNMENTS]
    settings = [{"alignment": a, "augmentation": AugmentConfig(yaw=yaw)} for a, yaw in variants]
    weights = trained_dsm(workspace, domains.folder(DOMAIN, "train"), plan.steps, settings)
    result = {
        _name(*variant): load_method("dsm", path)
        for variant, path in zip(variants, weights, strict=True)
    }
    return result | {f"{name}, as shipped": create(name, 1) for name in _UNTRAINED}


def _summary(delta: Float64) -> tuple[Cell, ...]:
    """Return the mean over angles and segments, the 95 % quantile, and the worst angle's mean."""
    moved = delta[(DEGREES % 360) != 0]
    return (
        round(float(moved.mean()), 4),
        round(float(np.quantile(moved, 0.95)), 4),
        round(float(moved.mean(axis=1).max()), 4),
    )


def _table(rows: list[tuple[Cell, ...]], plan: Plan) -> Table:
    columns = ("descriptor", "mean delta", "95 % of all below", "mean at worst angle", "area")
    note = (
        f"Lower deltas are better. {plan.steps} steps of training each. Area: under the ROC over "
        "pairs of segments as they stand, mostly of like headings: alignment may cost some. "
        "Turns of training segments are drawn from the whole circle, in the paper from half of it."
    )
    return Table("rotation", "Mean deviation under rotation", columns, tuple(rows), note)


def _figure(found: Mapping[str, Float64], augmented: bool) -> Figure:
    series = {
        _WORDS[alignment]: (DEGREES, found[_name(alignment, augmented)].mean(axis=1))
        for alignment in _ALIGNMENTS
    }
    # Both drawings to one scale, or the smaller deviations would look like the larger ones.
    most = max(float(each.mean(axis=1).max()) for each in found.values())
    title = "Trained with random turns" if augmented else "Trained without random turns"
    name = f"rotation_{'augmented' if augmented else 'plain'}"
    return Figure(name, title, "polar", series, "degrees", "delta", top=1.05 * most)
