"""A road network: junctions joined by curved streets that no two blocks share the shape of."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from segloc.errors import ConfigError
from segloc.geometry import arc_length
from segloc.types import Float64, Int64


@dataclass(frozen=True)
class Street:
    """One street between two junctions."""

    nodes: tuple[int, int]  # the junctions at its ends
    line: Float64  # (n, 2), from the first to the second, a point every half metre or so
    half_width: float  # from the centre line to the kerb, metres

    @property
    def length(self) -> float:
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())

    def at(self, distance: ArrayLike, offset: ArrayLike = 0.0) -> tuple[Float64, Float64]:
        """Points (..., 2) at a distance along the street and ``offset`` to its left, with yaws."""
        s, side = np.broadcast_arrays(np.asarray(distance, dtype=float), offset)
        return along(self.line, s, side)


def along(line: Float64, distance: Float64, offset: ArrayLike = 0.0) -> tuple[Float64, Float64]:
    """Points and headings at arc lengths of a polyline, ``offset`` metres to its left."""
    arc = arc_length(line)
    tangent = np.gradient(line, arc, axis=0)
    x, y = (np.interp(distance, arc, line[:, k]) for k in (0, 1))
    ahead, left = (np.interp(distance, arc, tangent[:, k]) for k in (0, 1))
    yaw = np.arctan2(left, ahead)
    point = np.stack([x - np.sin(yaw) * offset, y + np.cos(yaw) * offset], axis=-1)
    return point, yaw


@dataclass(frozen=True)
class RoadNetwork:
    """Junctions and the streets between them."""

    nodes: Float64  # (n, 2), metres
    streets: tuple[Street, ...]
    rounding_m: float = 2.5  # over which corners are rounded when they are driven
    _tree: tuple[cKDTree, Float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        points = np.concatenate([street.line for street in self.streets])
        width = np.concatenate([np.full(len(s.line), s.half_width) for s in self.streets])
        object.__setattr__(self, "_tree", (cKDTree(points), width))

    def clearance(self, xy: ArrayLike) -> Float64:
        """Distance of points (..., 2) from the nearest kerb, negative on the carriageway."""
        tree, width = self._tree
        points = np.asarray(xy, dtype=float)
        distance, index = tree.query(points.reshape(-1, 2))
        return np.asarray(distance - width[index], dtype=np.float64).reshape(points.shape[:-1])

    def neighbours(self, node: int) -> list[int]:
        """Junctions one street away, rising."""
        ends = [street.nodes for street in self.streets if node in street.nodes]
        return sorted(b if a == node else a for a, b in ends)

    def centre_line(self, route: list[int]) -> Float64:
        """The (n, 2) centre line through a list of neighbouring junctions."""
        if len(route) < 2:
            raise ConfigError(f"a route needs at least two junctions, not {len(route)}")
        pieces = [self._street_between(a, b) for a, b in pairwise(route)]
        return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])

    def _street_between(self, a: int, b: int) -> Float64:
        for street in self.streets:
            if street.nodes == (a, b):
                return street.line
            if street.nodes == (b, a):
                return street.line[::-1]
        raise ConfigError(f"no street joins junctions {a} and {b}")

    def length(self, route: list[int]) -> float:
        """Metres along a route of two junctions or more; 0 for a single one."""
        if len(route) < 2:
            return 0.0
        return float(np.linalg.norm(np.diff(self.centre_line(route), axis=0), axis=1).sum())

    def walk(
        self, rng: np.random.Generator, route: list[int], length: float, *, avoid: list[int]
    ) -> list[int]:
        """``route`` and then at least ``length`` metres more, without a U-turn.

        Takes streets that neither ``route`` nor the route ``avoid`` took, as long as there are any.
        """
        seen = {frozenset(pair) for way in (route, avoid) for pair in pairwise(way)}
        longer, start = list(route), self.length(route)
        while self.length(longer) < start + length:
            here, before = longer[-1], longer[-2] if len(longer) > 1 else -1
            options = [node for node in self.neighbours(here) if node != before]
            fresh = [node for node in options if frozenset((here, node)) not in seen]
            choice = int(rng.choice(fresh or options))
            seen.add(frozenset((here, choice)))
            longer.append(choice)
        return longer

    def join(self, route: list[int], other: list[int]) -> list[int]:
        """``route`` led on to the nearest junction of ``other``, and along that to its end.

        Nearest in number of streets, and such that the vehicle never turns back in a street.
        """
        queue: list[tuple[int, list[int]]] = [(route[-2], [route[-1]])]
        seen: set[tuple[int, int]] = set()
        while queue:
            before, path = queue.pop(0)
            here = path[-1]
            if here in other[:-1] and other[other.index(here) + 1] != before:
                return [*route[:-1], *path, *other[other.index(here) + 1 :]]
            for node in self.neighbours(here):
                if node != before and (here, node) not in seen:
                    seen.add((here, node))
                    queue.append((here, [*path, node]))
        return route


def street_network(
    rng: np.random.Generator,
    size_m: float,
    *,
    margin_m: float,
    block_m: float,
    half_width: tuple[float, float] = (3.4, 4.8),
    shift: float = 0.19,
    bend: float = 0.13,
    missing: float = 0.22,
) -> RoadNetwork:
    """A lattice of junctions bent out of shape, some streets missing, each street curved.

    ``shift`` is how far junctions leave the lattice, as a share of its step, ``bend`` how far
    streets leave the straight line, as a share of their length, and ``missing`` how many are
    left out.
    """
    count = max(2, round((size_m - 2 * margin_m) / block_m) + 1)
    axis = np.linspace(margin_m, size_m - margin_m, count)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    step = axis[1] - axis[0]
    nodes = nodes + rng.uniform(-shift, shift, nodes.shape) * step
    kept = _drop_some(rng, _lattice_pairs(count), len(nodes), share=missing)
    streets = []
    for a, b in kept.tolist():
        line = _curve(rng, nodes[a], nodes[b], bend)
        streets.append(Street((a, b), line, float(rng.uniform(*half_width))))
    return RoadNetwork(nodes, tuple(streets))


def straight(nodes: Float64, a: int, b: int, half_width: float) -> Street:
    """A straight street between two of (n, 2) junctions."""
    t = np.linspace(0, 1, max(3, int(np.linalg.norm(nodes[b] - nodes[a]) / 0.5)))[:, None]
    return Street((a, b), nodes[a] + t * (nodes[b] - nodes[a]), half_width)


def _lattice_pairs(count: int) -> Int64:
    index = np.arange(count * count).reshape(count, count)
    across = np.stack([index[:, :-1], index[:, 1:]], axis=-1).reshape(-1, 2)
    down = np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2)
    return np.concatenate([across, down])


def _drop_some(rng: np.random.Generator, pairs: Int64, nodes: int, share: float) -> Int64:
    """Leave out streets in random order while every junction keeps two and all stay connected."""
    keep = np.ones(len(pairs), dtype=bool)
    wanted = int(share * len(pairs))
    for k in rng.permutation(len(pairs)):
        if wanted == 0:
            break
        keep[k] = False
        fewest = np.bincount(pairs[keep].ravel(), minlength=nodes).min()
        keep[k] = fewest < 2 or not _connected(pairs[keep], nodes)
        wanted -= int(not keep[k])
    return pairs[keep]


def _connected(pairs: Int64, nodes: int) -> bool:
    label = np.arange(nodes)
    for _ in range(nodes):
        low = np.minimum(label[pairs[:, 0]], label[pairs[:, 1]])
        np.minimum.at(label, pairs[:, 0], low)
        np.minimum.at(label, pairs[:, 1], low)
        if not label.any():
            return True
    return False


def _curve(rng: np.random.Generator, start: Float64, end: Float64, bend: float) -> Float64:
    """A cubic from start to end whose control points lie up to ``bend`` lengths to either side."""
    chord = end - start
    normal = np.array([-chord[1], chord[0]])
    a, b = rng.uniform(-bend, bend, 2)
    first, second = start + chord / 3 + a * normal, start + 2 * chord / 3 + b * normal
    control = np.stack([start, first, second, end])
    t = np.linspace(0, 1, max(3, int(np.linalg.norm(chord) / 0.5)))[:, None]
    basis = np.concatenate([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    line: Float64 = basis @ control
    return line
