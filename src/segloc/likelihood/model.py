"""Log-likelihood ratio of a pose against "not in this map": a fitted weighted sum."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydantic import Field

from ..errors import ConfigError, WeightsError
from ..system.section import Section
from ..types import Float32, Pose
from .observation import CHANCE, Aligned, Count, Evidence, Walls

FEATURES = (
    "on_surface",
    "ground",
    "free_space",
    "inliers",
    "inliers_elsewhere",
    "overlap",
    "known_over_rival",
    "seen_over_rival",
    "in_view",
    "walls_over_rival",
    "off_planes",
)
"""Names of the features, in the order of :func:`features_of`."""
_COMPARED = (
    "on_surface",
    "ground",
    "free_space",
    "overlap",
    "known_over_rival",
    "seen_over_rival",
    "walls_over_rival",
)
"""Those of the two clouds, which tell less the more of a view lies on two planes."""
_OFF_PLANES_TELL = 0.1
"""By how much more they tell per unit of ``off_planes``. The likelihood is best with 0.15, without
ground with more, but the surest wrong places are believed more, and no more is found."""

_PRIOR, _SEEN_PRIOR = 10.0, 5.0
"""Points by which shares of surfaces and of the map in view are smoothed."""
_NEARLY_ALL = 0.05
"""Shares nearer to all or nothing than this are hardly told apart: noise decides there."""
_INSIDE = 0.03
"""Share of patches in free space that says as much as a map in view that is seen by chance."""
_KNOWN_PRIOR = 0.2
"""By how many points, as a share of all, those known are smoothed: a pose that the map knows
nothing about fits as chance does."""
CHANCE_WALLS = Walls(np.full(1, 0.4, np.float32), np.ones(1, np.float32))
"""Share of each wall patch that some pose of any map explains, and how sure that is."""
_WALLS_ALIKE = 0.15
"""Shares of a patch that are no farther apart say nothing: noise decides there."""
_WALLS_PRIOR = 5.0
"""Wall patches by which those told apart are smoothed."""
_CHANCE_INLIERS = 4
"""Inliers of some wrong pose of any map."""
_BEST_GAIN, _BEST_SEEN = 0.05, 2.0
"""Assumed of a place that was not aligned: gain of overlap by alignment, as a share, and log-odds
of the seen map points. In the worlds of the fit 2241 places that promise as much have the highest
confidence beside such places, all of them right; beside all measured places the least log-odds of
these are 7.9."""


class Measured(Protocol):
    """What the features of a pose are made of: an :class:`Observation`, or a kept row."""

    @property
    def inliers(self) -> int: ...
    @property
    def known(self) -> Evidence: ...
    @property
    def seen(self) -> Count: ...
    @property
    def inside(self) -> Count: ...
    @property
    def on_surface(self) -> Count: ...
    @property
    def ground(self) -> Count: ...
    @property
    def planes(self) -> Count: ...


class Promise(Section):
    """How likely a place competes, by what is known of it before it is measured to the end.

    A logistic regression: a constant and one weight a rough measure, fitted to places whose
    log-ratio is, or is not, above that of "not in this map".
    """

    weights: tuple[float, ...] = Field(description="constant, then one weight a measure")

    def log_odds(self, measures: Sequence[float]) -> float:
        """Return the log-odds that a place competes, by its rough measures."""
        return sum(w * x for w, x in zip(self.weights, (1.0, *measures), strict=True))


class Known(Section):
    """What a view says about a pose that is known already, by some of its features.

    A logistic regression, fitted to views from right and from wrong poses of robots that drive on.
    """

    weights: Mapping[str, float] = Field(description="weight of each feature that counts")
    constant: float = Field(description="log-odds without any")
    misleading: float = Field(gt=0, lt=0.5, description="probability that a view misleads")
    power: float = Field(gt=0, description="exponent of the unknown share that is no evidence")
    alike_m: float = Field(gt=0, description="way over which what views say decays to 1/e [m]")

    def alike(self, metres: float) -> float:
        """Return how alike the evidence of two views so many metres apart is, in [0, 1]."""
        return math.exp(-metres / self.alike_m)

    def evidence(self, features: Mapping[str, float], unknown: float) -> float:
        """Return the log-ratio of a view from a pose against one from elsewhere."""
        weighed = sum(weight * features[name] for name, weight in self.weights.items())
        right = 1.0 / (1.0 + math.exp(-self.constant - weighed))
        p = self.misleading + (1.0 - 2.0 * self.misleading) * right
        return self.information(unknown) * math.log(p / (1.0 - p))

    def information(self, unknown: float) -> float:
        """Return how much a view can say, in [0, 1]: less where the map knows less of it."""
        return float(1.0 - unknown**self.power)


class Model(Section):
    """Log-ratio of a pose: a weighted sum of its features, less that of "not in this map"."""

    format: int = Field(ge=7, le=7, description="format version")
    weights: Mapping[str, float] = Field(
        description="weight of each feature; natural logarithms, no unit"
    )
    walls_power: float = Field(
        2.0, ge=1, description="power by which the log-ratio of walls counts, with its sign"
    )
    none: float = Field(description='score of "not in this map"')
    rough: Promise = Field(description="of places before alignment")
    aligned: Promise = Field(description="of places after alignment with some of the points")
    known: Known = Field(description="of poses that are known already")
    unseen: float = Field(
        description="log-probability that a place without segment matches fits as well as the best"
    )
    lapse: float = Field(
        gt=0, lt=1, description="probability of a query unlike all queries of the fit"
    )
    settings: Mapping[str, Any] = Field(
        {}, description="configuration of the fit; other values are a note of a localizer"
    )
    card: Mapping[str, Any] = Field(description="data, command, figures and reliability of the fit")

    def log_ratio(self, features: Sequence[float]) -> float:
        """Return the log-ratio of a pose against "not in this map", by :func:`features_of`."""
        return sum(self.shares(features).values()) - self.none

    def shares(self, features: Sequence[float]) -> dict[str, float]:
        """Return the share of each feature in the log-ratio of a pose, by name."""
        terms = terms_of(features, self.walls_power)
        return {name: self.weights[name] * x for name, x in terms.items()}

    def margin(self, inliers: int, elsewhere: int) -> float:
        """Return the log-ratio of a pose to another that differs only in its inliers."""
        more = self.weights["inliers"] - self.weights["inliers_elsewhere"]
        return more * inlier_ratio(inliers, elsewhere)


def features_of(
    fit: Measured, overlap: float, rivals: Sequence[Sequence[float]], inliers: int, walls: float
) -> tuple[float, ...]:
    """Return the features of a pose.

    Parameters
    ----------
    fit : Measured
    overlap : float
        The first of its :func:`aligned_measures`.
    rivals : sequence of (overlap, seen)
        :func:`aligned_measures` of the other places among the most promising ones. The pose is
        compared with the one that overlaps most, or with chance if that is higher. The less that
        one fits, the less it says about how much of a map is seen anywhere.
    inliers : int
        Most inliers of any pose at another place.
    walls : float
        Least :func:`walls_over` of chance and of the other places that overlap most.
    """
    chance, unseen = CHANCE_RIVAL
    most, seen = max(rivals, key=lambda rival: rival[0], default=CHANCE_RIVAL)
    likely = 1.0 / (1.0 + math.exp(-2.0 * (most - chance)))
    seen_over = fit.seen.log_odds(_SEEN_PRIOR) - likely * max(seen, unseen)
    return (
        surface_odds(fit.on_surface),
        surface_odds(fit.ground),
        # Both tell of empty space: what the one does not show, the other need not show again.
        max(free_space(fit.inside), seen_over),
        inlier_ratio(fit.inliers, 0),
        inlier_ratio(max(inliers, _CHANCE_INLIERS), 0),
        overlap - chance,
        known_odds(fit.known) - max(most, chance),
        seen_over,
        math.log1p(fit.seen.of),
        walls,
        # Two planes, as of a corner, fit in many places of any map.
        -share_odds(1.0 if fit.planes.share is None else fit.planes.share),
    )


def terms_of(features: Sequence[float], walls_power: float) -> dict[str, float]:
    """Return what is weighed, by name and in order: :func:`features_of`, by how much they tell.

    Things that were moved make a few pieces of wall differ, but not many: the square of the
    log-ratio of walls tells more. But in the mirror image of a room most walls are the same, and by
    the square real rooms were believed there where no ground tells.
    """
    terms = by_name(features)
    terms["walls_over_rival"] *= abs(terms["walls_over_rival"]) ** (walls_power - 1.0)
    telling = 1.0 + _OFF_PLANES_TELL * terms["off_planes"]
    for name in _COMPARED:
        terms[name] *= telling
    return terms


def by_name(features: Sequence[float]) -> dict[str, float]:
    """Return features of :func:`features_of` by their names."""
    return dict(zip(FEATURES, features, strict=True))


def rough_measures(overlap: float, rival: float, inliers: int, elsewhere: int) -> tuple[float, ...]:
    """Return what is known of a place before alignment.

    Parameters
    ----------
    overlap, rival : float
        Overlap here, and the largest one elsewhere.
    inliers, elsewhere : int
        Segments that agree here, and at most elsewhere.
    """
    odds = share_odds(overlap)
    over = odds - max(share_odds(rival), share_odds(CHANCE))
    return odds, over, inlier_ratio(inliers, elsewhere)


def aligned_measures(aligned: Aligned) -> tuple[float, ...]:
    """Return what is known of a place after alignment with some of the points."""
    return share_odds(aligned.overlap), aligned.seen.log_odds(_SEEN_PRIOR)


def best_case_measures(overlap: float) -> tuple[float, ...]:
    """Return the best :func:`aligned_measures` assumed of a place by its rough overlap."""
    return share_odds(min(overlap + _BEST_GAIN, 1.0)), _BEST_SEEN


def walls_over(here: Walls, elsewhere: Walls = CHANCE_WALLS) -> float:
    """Return the log-ratio of the walls that only one of two poses explains."""
    differ = wall_differences(here, elsewhere)
    total, either = float(differ.sum()), float(np.abs(differ).sum())
    return math.log((either + total + 2 * _WALLS_PRIOR) / (either - total + 2 * _WALLS_PRIOR))


def wall_differences(here: Walls, elsewhere: Walls) -> Float32:
    """Return how much better each wall patch is explained here, weighed; 0 where hardly at all."""
    more, weight = here.explained - elsewhere.explained, np.minimum(here.weight, elsewhere.weight)
    differ: Float32 = np.where(np.abs(more) > _WALLS_ALIKE, weight * more, 0.0)
    return differ


def known_odds(known: Evidence) -> float:
    """Return the log-odds of the points on the map to those beside it; chance if all is unknown."""
    least = _KNOWN_PRIOR * max(known.of, 1)
    on, off = known.on + CHANCE * least, known.off + (1.0 - CHANCE) * least
    return math.log(on / off)


def inlier_ratio(inliers: int, elsewhere: int) -> float:
    """Return the log of the ratio of inliers to those elsewhere, or to chance."""
    return math.log1p(inliers) - math.log1p(max(elsewhere, _CHANCE_INLIERS))


def as_by_chance(_: Pose) -> int:
    """Return the inliers of a pose where segments are not matched: no evidence."""
    return _CHANCE_INLIERS


def free_space(inside: Count) -> float:
    """Return the log of how few patches are in free space."""
    return math.log(_INSIDE * (inside.of + 60.0) / (inside.hits + 3.0))


def share_odds(share: float) -> float:
    """Return the log-odds of a share, bounded at 0 and 1."""
    return math.log((share + _NEARLY_ALL) / (1.0 + _NEARLY_ALL - share))


def surface_odds(count: Count) -> float:
    """Return the log-odds of the points on surfaces of the map."""
    return count.log_odds(_PRIOR + _NEARLY_ALL * count.of)


CHANCE_RIVAL = share_odds(CHANCE), 0.0
"""Measures of the best wrong pose of any map: half of the map in view is seen."""


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
    if not set(model.known.weights) <= set(FEATURES):
        raise WeightsError(f"{path}: of a known pose only {', '.join(FEATURES)} are measured")
    return model


def shipped_model(*, ground: bool = True) -> Model:
    """Return the shipped model, or that of maps without ground."""
    return _load_shipped("posterior.json" if ground else "posterior-without-ground.json")


@cache
def _load_shipped(name: str) -> Model:
    return load_model(Path(__file__).resolve().parent.parent / "weights" / name)
