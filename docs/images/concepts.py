"""Draw the pictures of docs/explanation/method.md from a simulated town.

python docs/images/concepts.py            # writes beside itself; needs the extras sim and report
"""

from __future__ import annotations

import argparse
import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree
from segloc_lab.simulation import Conditions, hdl64e, simulate_sessions, town

from segloc import Config, Localizer, build_map, geometry
from segloc.frontend.segmentation import Segmentation
from segloc.likelihood import ScoredPose
from segloc.likelihood.observation import BEHIND_M, OVERLAP_M, SEEN_M, VIEW_DEG, VIEW_M
from segloc.pipeline import Query as Described
from segloc.tools.inspect.pictures import BLUE, DARK, GREEN, GREY, RED
from segloc.types import Candidate, Matches

Floats = NDArray[np.float64]

HALF_VIEW_M = 32.0
"""Half the side of the pictures that look down on the query."""
FAR_M = 15.0
"""The wrong candidate is at least so far from the right one."""


@dataclass(frozen=True)
class Query:
    """One query of the second drive, and what each stage made of it."""

    localizer: Localizer
    described: Described
    matches: Matches
    right: ScoredPose
    wrong: ScoredPose

    @property
    def scene(self) -> Segmentation:
        """The query's segments, structure and ground."""
        return self.described.scene


def make_query(seed: int) -> Query:
    """Drive twice through a town, map the first drive and take a query from the second."""
    first, second = simulate_sessions(
        town(seed, size_m=160.0), hdl64e(900), [Conditions(), Conditions(replaced=0.1)],
        length_m=110.0,
    )  # fmt: skip
    config = Config.preset("profile").model_copy(update={"threads": 1})
    localizer = Localizer(build_map(first, config), config)
    last = len(second) // 3
    described = localizer.describe([second.scan(i) for i in range(max(0, last - 20), last)])
    found, result = localizer.search(described), localizer.locate(described)
    if not result.localized:
        raise SystemExit(f"seed {seed}: the query is not localized: {result.message}")
    truth = result.T_map_sensor @ geometry.inverse(described.cloud.T_local_sensor)
    best, scene = found.candidates[0], described.scene
    if np.linalg.norm((best.T_map_local - truth)[:2, 3]) > 2.0:
        raise SystemExit(f"seed {seed}: the first candidate is not the answer")
    wrong = _elsewhere(localizer, scene, found.matches, truth)
    likelihood = localizer.likelihood
    cloud = likelihood.query(scene)
    refined = []
    for h in (best, wrong):
        place = likelihood.compared(cloud, [h.T_map_local]).at(h.T_map_local, likelihood.separation)
        assert place is not None
        refined.append(replace(place, inliers=h.inliers))
    return Query(localizer, described, found.matches, *refined)


def _elsewhere(
    localizer: Localizer, scene: Segmentation, matches: Matches, truth: Floats
) -> Candidate:
    """The best candidate that the other matches give, far from the right one."""
    places = geometry.transform(truth, scene.segments.centroids)[matches.query]
    mapped = localizer.prior_map.centroids[matches.map]
    far = np.linalg.norm((places - mapped)[:, :2], axis=1) > FAR_M
    others = Matches(
        matches.query[far], matches.map[far], matches.distance[far], matches.score[far]
    )
    candidates = localizer.estimator.estimate(
        scene.segments.centroids, localizer.prior_map.centroids, others
    )
    apart = [np.linalg.norm((h.T_map_local - truth)[:2, 3]) > FAR_M for h in candidates]
    return candidates[apart.index(True)]


# --- the pictures ------------------------------------------------------------------------------


def local_cloud(query: Query) -> Figure:
    """Ground in grey, every segment in a colour of its own."""
    figure, axes = _from_above()
    ground, segments = query.scene.ground, query.scene.segments
    _dots(axes, ground, GREY, 3.0)
    _dots(axes, query.scene.structure, "#8a919c", 0.6)
    colours = mpl.colormaps["tab20"](np.arange(20))
    rng = np.random.default_rng(0)
    for k in range(len(segments)):
        _dots(axes, segments.segment(k), colours[rng.integers(20)], 1.2)
    axes.plot(0, 0, marker="^", color=RED, markersize=9)
    _scale(axes)
    return figure


def descriptor(query: Query) -> Figure:
    """One segment from the side and from above, and its descriptor as bars."""
    segments = query.scene.segments
    distance = np.linalg.norm(segments.centroids[:, :2], axis=1)
    extents = np.array([np.ptp(segments.segment(k), axis=0) for k in range(len(segments))])
    compact = (distance < 25) & (extents[:, :2].max(axis=1) < 6.0)
    k = int(np.argmax(np.where(compact, segments.sizes, -1)))
    points = segments.segment(k) - segments.centroids[k].astype(np.float32)
    figure = Figure(figsize=(8.0, 2.8), facecolor="white")
    side, above, bars = figure.subplots(1, 3, width_ratios=(1, 1, 2.2))
    for axes, columns, title in ((side, (0, 2), "from the side"), (above, (0, 1), "from above")):
        axes.scatter(*points[:, columns].T, s=1.5, color=BLUE, linewidths=0)
        axes.set_aspect("equal")
        axes.set_title(title, fontsize=9, color=DARK)
        axes.set_xlabel("m", fontsize=8)
        axes.tick_params(labelsize=7)
    vector = query.described.descriptors.vectors[k]
    bars.bar(np.arange(len(vector)), vector, color=BLUE, width=0.8)
    bars.axhline(0, color=DARK, linewidth=0.6)
    bars.set_title(f"its descriptor: {len(vector)} numbers", fontsize=9, color=DARK)
    bars.tick_params(labelsize=7)
    figure.tight_layout()
    return figure


def votes(query: Query) -> Figure:
    """Where the matches put the query when it is turned to the best yaw."""
    matches, prior_map = query.matches, query.localizer.prior_map
    turn = geometry.yaw_transform(geometry.heading(query.right.T_map_local))[:3, :3]
    centroids = query.scene.segments.centroids @ turn.T
    voted = (prior_map.centroids[matches.map] - centroids[matches.query])[:, :2]
    low = prior_map.centroids[:, :2].min(axis=0)
    high = prior_map.centroids[:, :2].max(axis=0)
    cells = np.floor(voted).astype(np.int64)
    voters = np.unique(np.column_stack([matches.query, cells]), axis=0)[:, 1:]
    inside = ((voters >= low) & (voters < high)).all(axis=1)
    edges = [np.arange(math.floor(a), math.ceil(b) + 1.0) for a, b in zip(low, high, strict=True)]
    counts, _, _ = np.histogram2d(*voters[inside].T + 0.5, bins=edges)
    figure = Figure(figsize=(6.4, 5.0), facecolor="white")
    axes = figure.subplots()
    image = axes.pcolormesh(edges[0], edges[1], counts.T, cmap="magma", norm=PowerNorm(0.35))
    axes.set_aspect("equal")
    x, y = query.right.T_map_local[:2, 3]
    axes.plot(x, y, "o", markersize=22, fillstyle="none", color="#5eead4", markeredgewidth=1.5)
    axes.set_xlabel("translation x, metres of the map frame", fontsize=8)
    axes.set_ylabel("translation y", fontsize=8)
    axes.tick_params(labelsize=7)
    figure.colorbar(image, ax=axes, shrink=0.8).set_label("query segments that vote", fontsize=8)
    figure.tight_layout()
    return figure


def overlap(query: Query) -> Figure:
    """The query cloud on the map, at the right pose and at a wrong one."""
    figure, both = _pair()
    for axes, candidate, title in _candidates(query, both):
        site, structure = _at(query, candidate), query.scene.structure
        near, _ = cKDTree(site).query(structure, distance_upper_bound=OVERLAP_M)
        _dots(axes, site, GREY, 0.5)
        _dots(axes, structure[~np.isfinite(near)], RED, 0.6)
        _dots(axes, structure[np.isfinite(near)], GREEN, 0.6)
        axes.set_title(f"{title}: overlap {candidate.overlap:.2f}", fontsize=10, color=DARK)
        _scale(axes)
    figure.tight_layout()
    return figure


def free_space(query: Query) -> Figure:
    """Map points that the query confirms, and those that lie in space it has seen to be free."""
    figure, both = _pair()
    for axes, candidate, title in _candidates(query, both):
        site = _at(query, candidate)
        site = site[np.linalg.norm(site[:, :2], axis=1) < VIEW_M]
        confirmed, violated = _judged(query, site)
        _dots(axes, site[~confirmed & ~violated], GREY, 0.5)
        _dots(axes, site[confirmed], GREEN, 0.7)
        _dots(axes, site[violated], RED, 0.9)
        axes.plot(0, 0, marker="^", color=DARK, markersize=7)
        share = candidate.seen or 0.0
        axes.set_title(f"{title}: {share:.2f} confirmed", fontsize=10, color=DARK)
        _scale(axes)
    figure.tight_layout()
    return figure


def features(query: Query) -> Figure:
    """What the confidence is made of, for the right candidate and for the best wrong one."""
    names = ("inliers", "overlap", "share of the map in view\nthat is confirmed")
    figure = Figure(figsize=(7.2, 2.6), facecolor="white")
    for axes, name, pick in zip(
        figure.subplots(1, 3), names,
        (lambda h: h.inliers, lambda h: h.overlap, lambda h: h.seen or 0.0), strict=True,
    ):  # fmt: skip
        values = [pick(query.right), pick(query.wrong)]
        shown = axes.bar(("right", "wrong"), values, color=(GREEN, RED), width=0.6)
        axes.bar_label(shown, [f"{value:.3g}" for value in values], fontsize=8)
        axes.set_title(name, fontsize=9, color=DARK)
        axes.set_ylim(0, 1.18 * max(values))
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    return figure


PICTURES = {
    "concept_local_cloud": local_cloud,
    "concept_descriptor": descriptor,
    "concept_votes": votes,
    "concept_overlap": overlap,
    "concept_free_space": free_space,
    "concept_features": features,
}


# --- helpers -----------------------------------------------------------------------------------


def _judged(query: Query, site: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which map points have a query point near them, and which lie in measured free space.

    The same idea as cpp/likelihood/visibility.h, in a few lines: a point is a violation if all
    that was measured in its direction, and in the eight directions about it, lies behind it.
    """
    near, _ = cKDTree(query.scene.structure).query(site, distance_upper_bound=SEEN_M)
    confirmed = np.isfinite(near)
    bins = math.radians(VIEW_DEG)
    shape = (round(2 * math.pi / bins) + 1, round(math.pi / bins) + 1)

    def pixels(points: Floats) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
        ranges = np.linalg.norm(points, axis=1)
        azimuth = np.arctan2(points[:, 1], points[:, 0]) + math.pi
        elevation = np.arcsin(points[:, 2] / ranges) + math.pi / 2
        return ranges, (azimuth / bins).astype(np.int64), (elevation / bins).astype(np.int64)

    image = np.full(shape, np.inf)
    ranges, column, row = pixels(query.scene.surface.astype(np.float64))
    np.minimum.at(image, (column, row), ranges)
    measured = np.isfinite(image)
    padded = np.pad(image, ((1, 1), (1, 1)), constant_values=np.inf)
    padded[0], padded[-1] = padded[-2], padded[1]
    about = [np.roll(padded, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    nearest = np.min(about, axis=0)[1:-1, 1:-1]
    ranges, column, row = pixels(site)
    free = measured[column, row] & (nearest[column, row] > ranges + BEHIND_M)
    above = _above_ground(query, site)
    return confirmed, free & above & ~confirmed


def _above_ground(query: Query, site: Floats) -> NDArray[np.bool_]:
    ground = query.scene.ground
    distance, nearest = cKDTree(ground[:, :2]).query(site[:, :2])
    above: NDArray[np.bool_] = (site[:, 2] > ground[nearest, 2] + 0.5) & (distance < 3.0)
    return above


def _at(query: Query, candidate: ScoredPose) -> Floats:
    """The map's cloud in the local frame, where the candidate puts it."""
    prior_map = query.localizer.prior_map
    points = prior_map.cloud.astype(np.float64) + prior_map.origin
    site = geometry.transform(geometry.inverse(candidate.T_map_local), points)
    return site[(np.abs(site[:, :2]) < 1.3 * HALF_VIEW_M).all(axis=1)]


def _candidates(query: Query, both: tuple[Axes, Axes]) -> list[tuple[Axes, ScoredPose, str]]:
    return [(both[0], query.right, "right pose"), (both[1], query.wrong, "wrong pose")]


def _from_above() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.4, 6.4), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    _square(axes)
    return figure, axes


def _pair() -> tuple[Figure, tuple[Axes, Axes]]:
    figure = Figure(figsize=(8.8, 4.7), facecolor="white")
    left, right = figure.subplots(1, 2)
    _square(left)
    _square(right)
    return figure, (left, right)


def _square(axes: Axes) -> None:
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(-HALF_VIEW_M, HALF_VIEW_M)
    axes.set_ylim(-HALF_VIEW_M, HALF_VIEW_M)


def _dots(axes: Axes, points: NDArray[np.floating], colour: object, size: float) -> None:
    axes.scatter(points[:, 0], points[:, 1], s=size, color=colour, linewidths=0)


def _scale(axes: Axes) -> None:
    left, low = -0.94 * HALF_VIEW_M, -0.94 * HALF_VIEW_M
    axes.plot([left, left + 10], [low, low], color=DARK, linewidth=2)
    axes.text(left + 5, low + 1, "10 m", ha="center", fontsize=9, color=DARK)


def save(figure: Figure, path: Path, colours: int = 64) -> None:
    """A PNG of few colours, which keeps it small."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=100)
    with Image.open(drawn) as image:
        few = image.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
        few.save(path, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    query = make_query(options.seed)
    for name, draw in PICTURES.items():
        save(draw(query), options.out / f"{name}.png")


if __name__ == "__main__":
    main()
