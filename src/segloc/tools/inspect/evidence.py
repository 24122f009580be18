"""Evidence for and against the best pose of a query, and over the runner-up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...likelihood import (
    CHANCE_WALLS,
    Count,
    Evidence,
    Model,
    Observation,
    ScoredPose,
    Walls,
    by_name,
    features_of,
    wall_differences,
)
from ...likelihood.model import CHANCE_RIVAL, as_by_chance, free_space, known_odds
from ...pipeline import Search
from ...proposals.first_sight import FirstSight
from ...system.text import quantity

LABELS = {
    "walls": ("on_surface",),
    "ground": ("ground",),
    "free space": ("free_space",),
    "segments": ("inliers", "inliers_elsewhere"),
    "points": ("overlap", "known_over_rival"),
    "map in view": ("seen_over_rival", "in_view"),
    "wall by wall": ("walls_over_rival",),
}
"""What is listed, and the features of each."""
MIN_LOG_ODDS = 0.05
"""Share in log-odds below which a feature counts neither for nor against a pose."""


class _Unmeasured(NamedTuple):
    """A pose at which nothing was measured."""

    inliers: int = as_by_chance(np.eye(4))
    known: Evidence = Evidence(0, 0, 0)
    seen: Count = Count(0, 0)
    inside: Count = Count(0, 0)
    on_surface: Count = Count(0, 0)
    ground: Count = Count(0, 0)
    planes: Count = Count(0, 0)


_CHANCE_INLIERS = _Unmeasured().inliers
_CHANCE_SHARE = 1.0 / (1.0 + math.exp(-known_odds(_Unmeasured().known)))
_CHANCE_SEEN = 0.5
_PRIOR = ("in_view", "off_planes")
"""Features of what is in view, rather than of how it fits."""
_WORTH_NOTHING = features_of(_Unmeasured(), CHANCE_RIVAL[0], (), _CHANCE_INLIERS, 0.0)


@dataclass(frozen=True)
class Part:
    """What one thing that was measured says of the best pose.

    Attributes
    ----------
    label : str
        Of :data:`LABELS`.
    log_odds : float
        Share in the log-odds of the pose; 0 of what was not measured.
    words : str
        What was measured, and with what it is compared.
    over : float
        Share in the log-odds of the pose over the runner-up; 0 without one.
    beside : str
        What was measured at the pose and at the runner-up; "" without one.
    """

    label: str
    log_odds: float
    words: str
    over: float = 0.0
    beside: str = ""


def prior_log_odds(model: Model, pose: ScoredPose | None) -> float:
    """Return the log-odds of a pose by what is in view, before anything else is measured."""
    return model.log_ratio(_WORTH_NOTHING if pose is None else _unfitted(pose.features))


def parts_of(model: Model, found: Search) -> tuple[Part, ...]:
    """Return the shares in the log-odds of the most probable place."""
    best, *others = found.posterior.places
    fit, beside = _fit(found, best), dict.fromkeys(LABELS, "")
    words, over = _describe_fit(found, fit), dict.fromkeys(LABELS, 0.0)
    if others:
        over = _shares(model, best.features, others[0].features)
        beside = _beside(fit, _fit(found, others[0]))
    if found.proposer == FirstSight.name:
        words["segments"] = "not measured: first sight decides without segments"
        beside["segments"] = ""
    if by_name(best.features)["free_space"] > free_space(fit.inside):
        words["free space"] = f"the map in view tells more; {words['free space']}"
    shares = _shares(model, best.features, _unfitted(best.features))
    return tuple(
        Part(label, shares[label], words[label], over[label], beside[label]) for label in LABELS
    )


def _unfitted(features: Sequence[float]) -> tuple[float, ...]:
    """Return the features of the same view at a pose at which nothing was measured."""
    nothing = by_name(_WORTH_NOTHING)
    return tuple(x if n in _PRIOR else nothing[n] for n, x in by_name(features).items())


def _shares(model: Model, here: Sequence[float], there: Sequence[float]) -> dict[str, float]:
    """Return, by label, what the features of one pose add to the log-odds over another's."""
    more, less = model.shares(here), model.shares(there)
    return {
        label: sum(more[name] - less[name] for name in names) for label, names in LABELS.items()
    }


def evidence_rows(
    prior: float, parts: Sequence[Part]
) -> Iterator[tuple[str, list[tuple[float, str, str]]]]:
    """Yield groups of evidence, each with its shares in log-odds, labels and words.

    ``prior`` is :func:`prior_log_odds`. The largest share of a group comes first.
    """
    rows = [(part.log_odds, part.label, part.words) for part in parts]
    rows.append(
        (
            prior,
            "prior",
            "most poses are wrong; the more is in view, the more must fit, and two planes fit in "
            "many places",
        )
    )
    rows.sort(key=lambda row: -abs(row[0]))
    for name, chosen in (
        ("for this pose", [row for row in rows if row[0] >= MIN_LOG_ODDS]),
        ("against it", [row for row in rows if row[0] <= -MIN_LOG_ODDS]),
        ("neither", [(0.0, *row[1:]) for row in rows if abs(row[0]) < MIN_LOG_ODDS]),
    ):
        if chosen:
            yield name, chosen


def runner_up_rows(parts: Sequence[Part]) -> list[tuple[float, str, str]]:
    """Return the features in which the best pose and the runner-up differ, the largest first."""
    rows = [(part.over, part.label, part.beside) for part in parts if part.beside]
    return sorted(
        (row for row in rows if abs(row[0]) >= MIN_LOG_ODDS), key=lambda row: -abs(row[0])
    )


def _fit(found: Search, place: ScoredPose) -> Observation:
    """Return what was measured at a place of the posterior."""
    trials = [trial for trial in found.places if trial.fit is not None]
    measured = ((trial.fit, at) for trial in trials for at in (trial.fit, trial.finest))
    return next(fit for fit, at in measured if fit and at and at.T_map_local is place.T_map_local)


def _known_count(fit: Observation) -> Count:
    """Return the points on the map, of those in known space."""
    return Count(fit.known.on, fit.known.on + fit.known.off)


def _counts(fit: Observation) -> dict[str, tuple[Count, str, str]]:
    """Return each share that is measured at a pose, in words, and why it may be unknown."""
    return {
        "walls": (
            fit.on_surface,
            "of the wall points lie on the map's walls",
            "no walls of the map near those of the query",
        ),
        "ground": (
            fit.ground,
            "of the ground points lie on the map's ground",
            "no ground of the map near that of the query",
        ),
        "free space": (
            fit.inside,
            "of the surfaces lie in space that is free in the map",
            "no free space of the map is known",
        ),
        "points": (
            _known_count(fit),
            "of the points in known space lie on the map",
            "the map knows nothing where the points lie",
        ),
        "map in view": (
            fit.seen,
            "of the map in view is seen",
            "nothing of the map is in view",
        ),
    }


def _describe_fit(found: Search, fit: Observation) -> dict[str, str]:
    """Describe what was measured at a pose, and with what it is compared."""
    words = {
        name: f"{count.share:.0%} {what}" if count.of else f"not measured: {missing}"
        for name, (count, what, missing) in _counts(fit).items()
    }
    others = [place for place in found.places if place.fit is not fit]
    aligned = (place.aligned for place in others if place.aligned is not None)
    rival = max(aligned, key=lambda one: one.overlap, default=None)
    overlap, seen = (0.0, 0.0) if rival is None else (rival.overlap, rival.seen.share or 0.0)
    words["points"] += _elsewhere(overlap, _CHANCE_SHARE)
    words["map in view"] += _elsewhere(seen, _CHANCE_SEEN)
    inliers = max([0, *(place.inliers for place in others)])
    words["segments"] = quantity(fit.inliers, "segments", "agree") + (
        f"; {inliers} elsewhere" if inliers > _CHANCE_INLIERS else f"; {_CHANCE_INLIERS} by chance"
    )
    beside = next(place.beside for place in found.places if place.fit is fit)
    assert beside is not None  # the posterior has what was scored
    words["wall by wall"] = _walls(fit.walls, beside)
    return words


def _elsewhere(share: float, by_chance: float) -> str:
    """Return what a share at the pose is compared with: elsewhere, or chance if that is more."""
    return f"; {share:.0%} elsewhere" if share > by_chance else f"; {by_chance:.0%} by chance"


def _walls(here: Walls, beside: Walls) -> str:
    """Count the patches of walls that tell a pose from another place, or from chance."""
    known = int((here.weight > 0.0).sum())
    if not known:
        return "not measured: the map knows nothing about the walls of the query"
    better, worse = _count_differing(here, beside)
    than = "by chance" if beside is CHANCE_WALLS else "elsewhere"
    return f"of {quantity(known, 'pieces')} of wall {better} fit better than {than}, {worse} worse"


def _count_differing(here: Walls, other: Walls) -> tuple[int, int]:
    """Count the patches that fit better at one pose than at another, and those that fit worse."""
    differ = wall_differences(here, other)
    return int((differ > 0.0).sum()), int((differ < 0.0).sum())


def _beside(fit: Observation, other: Observation) -> dict[str, str]:
    """Describe what was measured at two poses."""
    there = _counts(other)
    words = {
        name: f"{_share(count)} {what}, {_share(there[name][0])} at the runner-up"
        for name, (count, what, _) in _counts(fit).items()
    }
    agree = quantity(fit.inliers, "segments", "agree")
    words["segments"] = f"{agree}, {other.inliers} at the runner-up"
    better, worse = _count_differing(fit.walls, other.walls)
    words["wall by wall"] = f"{better} pieces of wall fit better here, {worse} at the runner-up"
    return words


def _share(count: Count) -> str:
    return "an unknown share" if count.share is None else f"{count.share:.0%}"
