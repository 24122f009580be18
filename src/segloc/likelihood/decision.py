"""The verdict: a pure function of the evidence, on one screen."""

from __future__ import annotations

from typing import NamedTuple

from ..localization import Reason, ambiguous_with
from .confidence import ConfidenceModel
from .config import VerificationConfig
from .evidence import (
    DECISIVE_INLIERS,
    REPEATED_EVIDENCE,
    SQUARE_M,
    Evidence,
    RankedCandidate,
    RefinedScore,
    Score,
    Verdict,
)

RIVAL_STANDING = 0.5
"""A rival counts if, with nothing but chance elsewhere, it were at least half as likely as the best
pose. Set by hand."""
OUTDONE = 5.0
"""A rival is no equal where the pose is so much likelier, in log-odds, when the two are compared
with each other alone. Chosen on the worlds of the calibration."""
SUPPORTED_FIT = 0.7
"""However many segments agree with a rival, it is no equal where the clouds fit so much worse. Set
by hand."""
GROUND_FITS = 0.4
"""With less of the ground on that of the map a pose is wrong; at right ones of real recordings at
least half of it is. Set by hand."""
MOST_INTRUDING = 0.02
"""Where more of what is seen stands in free space of the map a pose is doubted. Chosen on 32
simulated worlds that the calibration does not have."""
FEW_INLIERS = 5
"""Fewer than these say little. Set by hand."""
CONFINED = 21
"""What stands on fewer squares may be one room, and rooms are like others. Chosen on 22
simulated floors of offices that the calibration does not have."""
NEARLY_ALL, FEW_IN_VIEW, FAR_WORSE = 0.975, 200, 12.0
"""A storey is told from the others where so much of what is seen lies on the map, with so many map
points in view, and the pose is so much likelier than those above and below, in log-odds. Chosen on
some 80 simulated worlds, and on buildings, that the calibration does not have."""
FAR_BETWEEN_WALLS_M, FAR_M = 8.0, 25.0
"""What lies farther from the path of the map is mapped from one side, and thinly: where walls are
flush, and elsewhere. Beyond the second, half of what a query shows may lie off the map, where
nothing speaks against it. Chosen on 40 simulated worlds that the calibration does not have, and
with KITTI 00 in view."""
CAUTIOUSLY, MOSTLY_FLUSH = 0.97, 0.6
"""Where segments decide little and not much is in view, a pose is doubted that is less likely than
the first by the cautious model, if at least the second of its walls is flush: all wrong poses that
look likely have such walls, while hedges and facades further off have not. Chosen on 52 simulated
worlds that the calibration does not have; the second also with KITTI 00 in view."""
LENIENT_ROOT, UNDECIDED_ROOT, REPEATED_ROOT = 7.3, 11.0, 33.0
"""The confidence that is needed where segments decide little, away from flush walls or on a storey
that is told from the others, and elsewhere; and where they decide, but may do so for another part
of a place that repeats itself: these roots of the one that suffices (of 0.8: 0.97, 0.98 and 0.993).
Chosen on the same worlds as what they stand for, the first with KITTI 00 in view."""
DOUBTED_ROOT, CONFINED_ROOT = 250.0, 5000.0
"""The same where the pose is doubted; and where the view is confined, or the pose at the edge of
the map (of 0.8: 0.9991 and 0.99996)."""


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
    elif lacks := lacking(evidence, model, config):
        reason, message = Reason.TOO_UNCERTAIN, lacks
    else:
        return Verdict(None, "", p, best, evidence, runner_up)
    return Verdict(reason, message, p, best, evidence, runner_up)


def lacking(evidence: Evidence, model: ConfidenceModel, config: VerificationConfig) -> str:
    """What is missing for a pose to be believed; "" where nothing is.

    No pose is whose confidence, which is cut, is below the one that suffices.
    """
    sure, demanded = model.unbounded(evidence), demand(evidence, model)
    if demanded.confidence(config) <= sure < Demand(DOUBTED_ROOT).confidence(config):
        demanded = demand_of_intruders(evidence) or demanded  # it takes time
    needed = demanded.confidence(config)
    if sure >= needed:
        sure, needed = model.probability(evidence), config.min_confidence
    if sure >= needed:
        return ""
    below = Reason.TOO_UNCERTAIN.below(sure, needed)
    return f"{below}: {compared(evidence)}{demanded.why}"


def too_few_inliers(
    best: RankedCandidate, runner_up: RankedCandidate | None, config: VerificationConfig
) -> Verdict:
    """What is decided without looking at the clouds."""
    message = f"too few inliers ({best.inliers} < {config.min_inliers})"
    return Verdict(Reason.TOO_FEW_INLIERS, message, 0.0, best, None, runner_up)


class Demand(NamedTuple):
    """How much confidence is needed.

    Attributes
    ----------
    root : float
        This root of the confidence that suffices.
    why : str
        The end of a sentence that says so.
    """

    root: float
    why: str = ""

    def confidence(self, config: VerificationConfig) -> float:
        """What is needed, in [0, 1]."""
        return float(config.min_confidence ** (1.0 / self.root))


def demand(evidence: Evidence, model: ConfidenceModel) -> Demand:
    """More where segments decide little, or may do so for a part of the map that is like another;
    most where no more is in view than a room."""
    if not decide_little(evidence):
        if may_be_repeated(evidence, model):
            return Demand(REPEATED_ROOT, "; hardly more segments agree than elsewhere")
        return Demand(1.0)
    if is_told_from_other_storeys(evidence, model):
        return Demand(LENIENT_ROOT)
    if why := confinement(evidence):
        return Demand(CONFINED_ROOT, why)
    if why := doubt(evidence, model):
        return Demand(DOUBTED_ROOT, why)
    return Demand(UNDECIDED_ROOT if is_built(evidence) else LENIENT_ROOT)


def demand_of_intruders(evidence: Evidence) -> Demand | None:
    """More where things would stand in free space of the map, unless segments decide: things are
    moved, too."""
    if evidence.inlier_evidence >= REPEATED_EVIDENCE:
        return None
    if (share := evidence.score.intruding) <= MOST_INTRUDING:
        return None
    why = f"; {share:.1%} of what is seen stands where the map is known to be free"
    return Demand(DOUBTED_ROOT, why)


def confinement(evidence: Evidence) -> str:
    """Why next to nothing could speak against a pose, as the end of a sentence; "" if much could.

    No more is in view than a room, or what is lies beyond the edge of the map.
    """
    if evidence.extent is not None and evidence.extent < CONFINED:
        squares = f"{evidence.extent} squares of {SQUARE_M:g} m"
        return f"; what is in view covers {squares}, as a room does"
    return off_the_path(evidence, FAR_M)


def is_told_from_other_storeys(evidence: Evidence, model: ConfidenceModel) -> bool:
    """Whether next to all that is seen is there, and much of it not on other storeys.

    Rooms of other buildings are alike, not the same; only a storey of this one would be.
    """
    best, others = evidence.score, evidence.other_storeys
    if not others or best.overlap < NEARLY_ALL or best.judged < FEW_IN_VIEW:
        return False
    return all(model.advantage(best, other) >= FAR_WORSE for other in others)


def doubt(evidence: Evidence, model: ConfidenceModel) -> str:
    """Why a pose is doubted that segments say little of, as the end of a sentence; "" if it is not.

    Bays of a hall are like those of another hall: in its map the best pose is likely only because
    others are worse. Where much of the map is in view, there is enough that would differ, unless it
    was mapped from far off.
    """
    if not is_built(evidence):
        return ""
    if why := off_the_path(evidence, FAR_BETWEEN_WALLS_M):
        return why
    if not sees_much(evidence, model):
        p = model.cautiously(evidence)
        if p < CAUTIOUSLY:
            return f"; by what fits there it is {p:.2f}, others are but worse"
    return ""


def off_the_path(evidence: Evidence, most_m: float) -> str:
    """That a pose is farther off the path of the map, as the end of a sentence; "" if it is not."""
    off = evidence.off_path or 0.0
    return f"; it is {off:.0f} m from the path of the map" if off > most_m else ""


def may_be_repeated(evidence: Evidence, model: ConfidenceModel) -> bool:
    """Whether the segments may agree on another part of a place that repeats itself.

    They do where the map ends within it.
    """
    if evidence.inlier_evidence >= REPEATED_EVIDENCE:
        return False
    return sees_much(evidence, model) or is_built(evidence)


def sees_much(evidence: Evidence, model: ConfidenceModel) -> bool:
    """Whether as many points of the map are in view as say anything."""
    return evidence.score.judged >= model.chance.most_judged


def is_built(evidence: Evidence) -> bool:
    """Whether most of the walls are flush, as people build them."""
    return (evidence.score.flush or 0.0) >= MOSTLY_FLUSH


def decide_little(evidence: Evidence) -> bool:
    """Whether few segments agree, or nearly as many elsewhere."""
    few = evidence.score.inliers < FEW_INLIERS
    return few or evidence.inlier_evidence < DECISIVE_INLIERS


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
        if (supported or fits) and stands and not is_outdone(rival, best, model):
            return rival
    return None


def is_outdone(rival: Score, best: Score, model: ConfidenceModel) -> bool:
    """Whether a pose is much likelier than a rival, all that is measured of both taken together.

    Halls that repeat themselves differ a little everywhere; storeys may differ by one thing, and so
    does a place from what it was when it was mapped.
    """
    if not (isinstance(rival, RefinedScore) and isinstance(best, RefinedScore)):
        return False
    return model.advantage(best, rival) >= OUTDONE
