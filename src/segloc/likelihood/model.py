"""Log-likelihood ratio of a pose against "not in this map": a fitted linear model."""

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
from .observation import DOUBTFUL, Count, Observation

FEATURES = (
    "in_view",
    "flush",
    "free_space",
    "inliers_over_rival",
    "overlap_over_rival",
    "seen_over_rival",
    "ground_over_rival",
    "flush_over_rival",
)
"""Names of the features, in the order of :meth:`Model.features`."""

_PRIOR = {"flush": 10.0, "ground": 10.0, "seen": 15.0}
"""Points by which shares are smoothed."""
_CHANCE_OVERLAP = 0.25
_CHANCE = {"flush": Count(40, 100), "ground": Count(80, 100), "seen": Count(50, 100)}
"""Counts of a runner-up if there is none; nor is its overlap or visibility taken to be lower."""
_CHANCE_INLIERS = 4
"""Inliers of some wrong pose of any map."""
_MAX_IN_VIEW = 3000
"""Largest number of map points in view that counts."""
FREE, OBSTRUCTED = Count(0, 2000), Count(2000, 2000)
"""Occupied free space at best and at worst."""

_SEEN, _INTRUDING = 0.75, 0.02
"""Shares of the seen map in view, and of a query in free space, at correct poses after changes."""


class Model(Section):
    """Log-ratio of a pose: a weighted sum of its features."""

    format: int = Field(ge=4, le=4, description="format version")
    weights: Mapping[str, float] = Field(
        description="weight of each feature; natural logarithms, no unit"
    )
    none: float = Field(description='score of "not in this map"')
    unseen: float = Field(
        description="log-probability that a place without segment matches fits as well as the best"
    )
    lapse: float = Field(
        ge=0, lt=1, description="probability of a query unlike all queries of the fit"
    )
    settings: Mapping[str, Any] = Field(
        {}, description="configuration of the fit; other values are a note of a localizer"
    )
    card: Mapping[str, Any] = Field(description="data, command, figures and reliability of the fit")

    def log_ratio(self, features: Sequence[float]) -> float:
        """Return the log-ratio of a pose against "not in this map", by :meth:`features`."""
        weighed = (self.weights[name] * x for name, x in zip(FEATURES, features, strict=True))
        return sum(weighed) - self.none

    def features(
        self,
        fit: Observation,
        others: Sequence[Observation],
        inliers: int,
        unknown: Count = DOUBTFUL,
    ) -> tuple[float, ...]:
        """Return the features of a pose.

        Parameters
        ----------
        fit : Observation
        others : sequence of Observation
            Fits at other places. Overlap and visibility are compared with the best of them, or with
            chance if that is higher: among places that do not fit at all, one that hardly fits is
            no better for it. Ground and walls are compared with the best of each.
        inliers : int
            Most inliers of any pose at another place.
        unknown : Count
            Occupied free space, if it was not measured.
        """
        overlap, seen = share_odds(_CHANCE_OVERLAP), _chance("seen")
        if others:
            odds = ((share_odds(o.overlap), _odds("seen", o.seen)) for o in others)
            best = max(odds, key=sum)
            overlap, seen = max(overlap, best[0]), max(seen, best[1])
        ground = max((_odds("ground", o.ground) for o in others), default=_chance("ground"))
        flush = max((_odds("flush", o.flush) for o in others), default=_chance("flush"))
        return (
            math.log(50.0 + min(fit.seen.of, _MAX_IN_VIEW)),
            _odds("flush", fit.flush),
            free_space(fit.intruding if fit.has("intruding") else unknown),
            inlier_ratio(fit.inliers, inliers),
            share_odds(fit.overlap) - overlap,
            _odds("seen", fit.seen) - seen,
            _odds("ground", fit.ground) - ground,
            _odds("flush", fit.flush) - flush,
        )

    def consistency(self, fit: Observation) -> float:
        """Return the part of a pose's score that is independent of unmapped parts of the query.

        Points in view of both are compared with those of correct poses after changes.
        """
        seen, intruding = fit.seen, fit.intruding
        usual = Count(round(_SEEN * seen.of), seen.of)
        clear = Count(round(_INTRUDING * intruding.of), intruding.of)
        return self.weights["seen_over_rival"] * (
            _odds("seen", seen) - _odds("seen", usual)
        ) + self.weights["free_space"] * (free_space(intruding) - free_space(clear))

    def margin(self, inliers: int, elsewhere: int) -> float:
        """Return the log-ratio of a pose to another that differs only in its inliers."""
        return 2.0 * self.weights["inliers_over_rival"] * inlier_ratio(inliers, elsewhere)


def inlier_ratio(inliers: int, elsewhere: int) -> float:
    """Return the log of the ratio of inliers to those elsewhere, or to chance."""
    return math.log1p(inliers) - math.log1p(max(elsewhere, _CHANCE_INLIERS))


def free_space(intruding: Count) -> float:
    """Return the negative log of the share of occupied free space."""
    return -math.log((intruding.hits + 2.0) / (intruding.of + 40.0))


def share_odds(share: float) -> float:
    """Return the log-odds of a share, bounded at 0 and 1."""
    return math.log((share + 0.05) / (1.05 - share))


def _odds(name: str, count: Count) -> float:
    return count.log_odds(_PRIOR[name])


def _chance(name: str) -> float:
    return _odds(name, _CHANCE[name])


def load_model(path: Path) -> Model:
    """Read a model.

    Raises
    ------
    WeightsError
        If the file is missing or damaged.
    """
    try:
        model = Model.model_validate(json.loads(path.read_text("utf-8")))
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ConfigError as error:
        raise WeightsError(f"{path}: {error}") from error
    except ValueError as error:
        raise WeightsError(f"{path}: damaged ({error})") from error
    if set(model.weights) != set(FEATURES):
        raise WeightsError(f"{path}: weights must be those of {', '.join(FEATURES)}")
    return model


@cache
def shipped_model() -> Model:
    """Return the shipped model."""
    return load_model(Path(__file__).resolve().parent.parent / "weights" / "posterior.json")
