"""The verdict: a pure function of the evidence, on one screen."""

from __future__ import annotations

import math

from ..localization import Reason, ambiguous_with
from .confidence import Chance, ConfidenceModel
from .config import VerificationConfig
from .evidence import (
    DECISIVE_INLIERS,
    Evidence,
    RankedCandidate,
    RefinedScore,
    Score,
    Verdict,
)

RIVAL_STANDING = 0.5
"""A rival counts if, with nothing but chance elsewhere, it were at least half as likely as the best
pose. Set by hand."""
UNEXPLAINED_TIMES, UNEXPLAINED_MORE = 2.0, 0.02
"""A direction speaks against a rival that leaves so many times as much of it unexplained, and so
much more. Set by hand."""
OUTDONE, AGAINST = 0.5, 0.25
"""A rival is no equal where this share of all directions speaks against it, and no more than this
share of those for it. One thing that has moved speaks in one direction. Set by hand."""

SUPPORTED_FIT = 0.7
"""However many segments agree with a rival, it is no equal where the clouds fit so much worse. Set
by hand."""
GROUND_FITS = 0.4
"""With less of the ground on that of the map a pose is wrong; at right ones of real recordings at
least half of it is. Set by hand."""
FEW_INLIERS = 5
"""Fewer than these say little. Set by hand."""
ALIKE, WHOLLY, SMALL_VIEW = 0.75, 0.98, 150
"""Where segments say little, and the clouds fit so nearly as well elsewhere, the place repeats
itself, unless this share of the cloud fits here, with at least so many map points in view. Chosen
on simulated offices and warehouses."""
FEW_ROOT, DOUBT_ROOT = 2.0, 20.0
"""The confidence that is needed where few segments agree, and where, besides, the place repeats
itself or little is in view (for both, twice the latter): these roots of the one that suffices.
Chosen on the same."""
WALLS_FIT, CLOUD_FITS = 0.05, 0.35
"""A pose is wrong where walls of some direction fit nowhere, and less of the cloud than this does.
Set by hand."""


def decide(
    evidence: Evidence,
    runner_up: RankedCandidate | None,
    model: ConfidenceModel,
    config: VerificationConfig,
) -> Verdict:
    """Believe a pose, or say why not.

    A pose is believed when no different place explains the query about as well, and its calibrated
    probability is high enough.
    """
    best, p = evidence.score, model.probability(evidence)
    if rival := equal_rival(evidence, model, config):
        reason, message = Reason.AMBIGUOUS, ambiguous_with(rival.T_map_local)
    elif (share := best.ground) is not None and share < GROUND_FITS:
        reason = Reason.TOO_UNCERTAIN
        message = f"the ground rises and falls otherwise there: {share:.0%} of it fits"
    elif best.overlap < CLOUD_FITS and best.walls is not None and best.walls < WALLS_FIT:
        reason = Reason.TOO_UNCERTAIN
        message = f"walls stand elsewhere there: {best.walls:.0%} of those of one direction fit"
    elif p < (needed := confidence_needed(evidence, model, config)):
        reason = Reason.TOO_UNCERTAIN
        message = f"{reason.below(p, needed)}: {compared(evidence)}"
    else:
        return Verdict(None, "", p, best, evidence, runner_up)
    return Verdict(reason, message, p, best, evidence, runner_up)


def too_few_inliers(
    best: RankedCandidate, runner_up: RankedCandidate | None, config: VerificationConfig
) -> Verdict:
    """What is decided without looking at the clouds."""
    message = f"too few inliers ({best.inliers} < {config.min_inliers})"
    return Verdict(Reason.TOO_FEW_INLIERS, message, 0.0, best, None, runner_up)


def confidence_needed(
    evidence: Evidence, model: ConfidenceModel, config: VerificationConfig
) -> float:
    """More where few segments agree, and most where other places look alike or little is in view.

    All wrong poses of the calibration that look likely are such.
    """
    best = evidence.score
    few = best.inliers < FEW_INLIERS
    doubts = is_alike(evidence, model.chance) + (few and best.judged < SMALL_VIEW)
    root = DOUBT_ROOT * doubts if doubts else FEW_ROOT if few else 1.0
    return float(config.min_confidence ** (1.0 / root))


def is_alike(evidence: Evidence, chance: Chance) -> bool:
    """Whether segments say little, and the clouds fit nearly as well at another place.

    A pose at which much overlaps is not like one at which, besides, what the map holds is seen.
    Places that are built alike differ somewhere: where much is in view, and hardly a point is left
    that does not fit, it is the right one.
    """
    best = evidence.score
    if best.inliers >= FEW_INLIERS and evidence.inlier_evidence >= DECISIVE_INLIERS:
        return False
    if best.overlap >= WHOLLY and best.judged >= SMALL_VIEW:
        return False
    return any(_both(rival, chance) >= ALIKE * _both(best, chance) for rival in evidence.rivals)


def _both(score: Score, chance: Chance) -> float:
    """How well the query fits the map, and the map the query."""
    return score.overlap * score.expected_seen(chance.judged)


def compared(evidence: Evidence) -> str:
    """What was measured at the best pose, beside the most of it at different places."""
    best, rivals = evidence.score, evidence.rivals
    elsewhere = (
        "nothing to compare it with elsewhere"
        if not rivals
        else f"elsewhere {max(r.overlap for r in rivals):.2f} and {max(r.inliers for r in rivals)}"
    )
    return f"overlap {best.overlap:.2f} and {best.inliers} inliers, {elsewhere}"


def equal_rival(
    evidence: Evidence, model: ConfidenceModel, config: VerificationConfig, slack: float = 1.0
) -> Score | None:
    """A rival that explains the query about as well, by its segments or by its clouds.

    Where a place repeats itself, it is chance which of its parts a segment is matched to: few
    matches do not speak against a place at which the clouds fit, nor do as few as chance brings
    about speak for one. With a ``slack`` below 1, rivals count too that might turn out to be equal
    once they are refined.
    """
    best = evidence.score
    alone = model.standalone(best)
    if alone < config.min_confidence:
        return None
    for rival in evidence.rivals:
        supported = (
            rival.inliers > model.chance.inliers
            and rival.support > config.rival_support_ratio * best.support
            and rival.overlap > SUPPORTED_FIT * best.overlap
        )
        fits = rival.overlap >= slack * config.rival_overlap_ratio * best.overlap
        stands = model.standalone(rival) >= RIVAL_STANDING * alone
        if (supported or fits) and stands and not is_outdone(rival, best):
            return rival
    return None


def is_outdone(rival: Score, best: Score) -> bool:
    """Whether the clouds fit better at the best pose all around.

    Halls that repeat themselves differ a little everywhere; storeys may differ by one thing, and so
    does a place from what it was when it was mapped.
    """
    if not (isinstance(rival, RefinedScore) and isinstance(best, RefinedScore)):
        return False
    pairs = [
        p
        for p in zip(best.details.sectors, rival.details.sectors, strict=True)
        if not any(map(math.isnan, p))
    ]
    against = sum(_speaks_against(b, a) for a, b in pairs)
    for_it = sum(_speaks_against(a, b) for a, b in pairs)
    return bool(pairs) and against >= OUTDONE * len(pairs) and for_it <= AGAINST * against


def _speaks_against(overlap: float, other: float) -> bool:
    return 1.0 - overlap > UNEXPLAINED_TIMES * (1.0 - other) + UNEXPLAINED_MORE
