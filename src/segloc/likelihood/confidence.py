"""How likely a pose is right, by its evidence: a logistic model, read from a carded file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field

from ..errors import ConfigError, WeightsError
from ..system.section import Section
from .evidence import Evidence, RefinedScore, Score

FEATURES = (
    "in_view",
    "flush",
    "ground",
    "inliers",
    "inliers_over_rival",
    "overlap_over_rival",
    "seen_over_rival",
    "flush_over_rival",
)
"""Names of the features, in the order of :meth:`ConfidenceModel.features`."""
CAUTIOUS_FEATURES = FEATURES[:6]
"""Those that the cautious model weighs."""


class Chance(Section):
    """What wrong poses reach by chance; it stands in for what is not known of rivals."""

    inliers: int = Field(ge=1, description="so many segments agree on some pose of any map")
    overlap: float = Field(ge=0, le=1, description="so well do clouds agree somewhere in any map")
    seen: float = Field(ge=0, le=1, description="so much of a map is seen somewhere")
    least_seen: float = Field(
        ge=0, le=1, description="a rival at which less is seen tells no more than one at this"
    )
    most_inliers: int = Field(
        ge=1, description="more segments than this agree on no wrong pose: more say no more"
    )
    flush: float = Field(ge=0, le=1, description="so much of the walls is flush somewhere")
    judged: float = Field(
        gt=0, description="the overlap counts as much as so many judged map points"
    )
    most_judged: int = Field(ge=1, description="more judged map points than this say no more")


class Logistic(Section):
    """Features that are weighed; those that have no weight do not count.

    Attributes
    ----------
    constant : float
    weights : dict of str to float
        By the names of :data:`FEATURES`.
    """

    constant: float
    weights: Mapping[str, float]

    def weighed(self, features: Sequence[float]) -> float:
        """The log-odds of all features, in their order."""
        odds = self.constant
        for name, feature in zip(FEATURES, features, strict=True):
            odds += self.weights.get(name, 0.0) * feature
        return odds


class ConfidenceModel(Logistic):
    """Probability that a candidate is right.

    The features compare a candidate with the best ones at other places of the same map: they say
    what chance achieves for this query. So no threshold depends on the map's size, the scene or the
    sensor.

    Attributes
    ----------
    cautious : Logistic
        A second opinion, of :data:`CAUTIOUS_FEATURES`: it does not count how much less is seen, or
        is flush, at other places. A map that lacks a place has none that is like it: that others
        are worse tells little there.
    chance : Chance
    max_inlier_evidence : float
        However many segments agree, clouds that disagree outweigh them.
    max_log_odds : float
        So many candidates as the model was fitted to show nothing to be surer.
    settings : dict
        The configuration under which the model was fitted.
    card : dict
        Data, command and figures of the fit.
    """

    format: int = Field(ge=2, le=2)
    cautious: Logistic
    chance: Chance
    max_inlier_evidence: float
    max_log_odds: float = Field(gt=0)
    settings: Mapping[str, Any]
    card: Mapping[str, Any]

    def probability(self, evidence: Evidence) -> float:
        """The confidence, in [0, 1)."""
        return _logistic(min(self._log_odds(evidence), self.max_log_odds))

    def unbounded(self, evidence: Evidence) -> float:
        """The same, where it may be surer than the model's candidates can show, in [0, 1]."""
        return _logistic(self._log_odds(evidence))

    def cautiously(self, evidence: Evidence) -> float:
        """The probability by the cautious model, in [0, 1]."""
        return _logistic(self.cautious.weighed(self.features(evidence)))

    def advantage(self, score: Score, rival: Score) -> float:
        """How much likelier a pose is than a rival, in log-odds, each compared with the other."""
        return self._against(score, rival) - self._against(rival, score)

    def _against(self, score: Score, other: Score) -> float:
        ratio = score.inliers / max(other.inliers, self.chance.inliers)
        return self._log_odds(Evidence(score, ratio, (other,)))

    def _log_odds(self, evidence: Evidence) -> float:
        return self.weighed(self.features(evidence))

    def features(self, evidence: Evidence) -> tuple[float, ...]:
        """What the model weighs.

        How much of the map is in view: a small room is like others. How much of the walls is flush,
        and of the ground fits. How many segments agree, and what that says against those elsewhere;
        how much more the clouds overlap, and is seen, than at the rival at which they agree best,
        and how much more of the walls is flush than at any. What is not known says what chance
        would, or the overlap.
        """
        score, chance = evidence.score, self.chance
        seen = log_odds(score.expected_seen(chance.judged))
        rival_overlap, rival_seen = self._rival(evidence)
        overlap = log_odds(score.overlap)
        flush, rival_flush = self._flush(evidence)
        return (
            math.log(chance.judged + min(score.judged, chance.most_judged)),
            flush,
            overlap if score.ground is None else log_odds(score.ground),
            math.log1p(min(score.inliers, chance.most_inliers)),
            min(evidence.inlier_evidence, self.max_inlier_evidence),
            overlap - rival_overlap,
            seen - rival_seen,
            flush - rival_flush,
        )

    def _rival(self, evidence: Evidence) -> tuple[float, float]:
        """Overlap and what is seen, as log-odds, at the rival where both together are most.

        A pose at which much overlaps explains nothing where the map in view is not seen.
        """
        chance = self.chance
        if not evidence.rivals:
            return log_odds(chance.overlap), log_odds(max(chance.seen, chance.least_seen))
        at = (
            (log_odds(r.overlap), log_odds(max(r.expected_seen(chance.judged), chance.least_seen)))
            for r in evidence.rivals
        )
        return max(at, key=sum)

    def _flush(self, evidence: Evidence) -> tuple[float, float]:
        """How much of the walls is flush, as log-odds, at the pose and at the rival of most.

        It is known of refined ones, chance stands in for other rivals. Where segments leave no
        doubt it is not measured, and where there are no walls it cannot be: then the overlap stands
        in, at rivals, too.
        """
        score, chance = evidence.score, log_odds(self.chance.flush)
        refined = [r for r in evidence.rivals if isinstance(r, RefinedScore)]
        if evidence.is_settled or score.flush is None:
            return log_odds(score.overlap), max([chance, *(log_odds(r.overlap) for r in refined)])
        return flush_odds(score), max([chance, *map(flush_odds, refined)])

    def standalone(self, score: Score) -> float:
        """The confidence if nothing but chance were at any other place."""
        return self.probability(self._alone(score))

    def standing(self, score: Score) -> float:
        """The same in log-odds, which are not cut."""
        return self._log_odds(self._alone(score))

    def _alone(self, score: Score) -> Evidence:
        return Evidence(score, score.inliers / self.chance.inliers, ())


def load_confidence(path: Path) -> ConfidenceModel:
    """Read a model.

    Raises
    ------
    WeightsError
        If the file is missing or damaged.
    """
    try:
        model = ConfidenceModel.model_validate(json.loads(path.read_text("utf-8")))
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ConfigError as error:
        raise WeightsError(f"{path}: {error}") from error
    except ValueError as error:
        raise WeightsError(f"{path}: damaged ({error})") from error
    for part, features in ((model, FEATURES), (model.cautious, CAUTIOUS_FEATURES)):
        if set(part.weights) != set(features):
            raise WeightsError(f"{path}: weights must be those of {', '.join(features)}")
    return model


@cache
def shipped_confidence() -> ConfidenceModel:
    """The model that comes with the package."""
    return load_confidence(Path(__file__).resolve().parent.parent / "weights" / "confidence.json")


def _logistic(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(min(-log_odds, 700.0)))  # beyond, it would overflow


def flush_odds(score: Score) -> float:
    """How much of the walls is flush, as log-odds; the overlap stands in where it is unknown."""
    return log_odds(score.overlap if score.flush is None else score.flush)


def log_odds(share: float) -> float:
    """The odds of a share on a logarithmic scale that ends at 0 and 1."""
    return math.log((share + 0.05) / (1.05 - share))
