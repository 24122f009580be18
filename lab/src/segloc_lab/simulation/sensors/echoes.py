"""Beams are cones: what a sensor reports where one meets the edge of something."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segloc.types import Float32, Int64

from ..objects.scene import Hits

_JUMP_M = 0.1  # a smaller step in range between two rays is no edge
_PULSE_M = 1.0  # echoes nearer to each other than this come back as one


def mix_echoes(
    hits: Hits, ways: Float32, stride: int, divergence: float, rng: np.random.Generator
) -> None:
    """Let rays near edges report what beams of some width would; changes ``hits`` in place.

    Where two neighbouring rays meet surfaces that are not each other's continuation there is an
    edge between them, and where exactly is drawn at random. A ray whose cone reaches over the edge
    gets part of its light from the other surface. Two echoes closer than the pulse is long are
    reported as one point between them; of others the stronger one is.

    Parameters
    ----------
    hits : Hits
        Of rays without width.
    ways : (R, 3) float32
        Unit directions in the world frame, firing by firing.
    stride : int
        Rays a firing: ray ``i + stride`` is the next of the same beam.
    divergence : float
        Full opening angle of a beam, radians.
    rng : Generator
        Decides where between two rays each edge is.
    """
    ray, other, share = _beams_on_edges(hits, ways, stride, divergence, rng)
    if not len(ray):
        return
    own, far = hits.ranges[ray], hits.ranges[other]
    strength = [_strength(hits, ray) * (1 - share), _strength(hits, other) * share]
    close = np.abs(own - far) < _PULSE_M  # never where one is infinite
    weight = strength[1] / np.maximum(strength[0] + strength[1], np.float32(1e-20))
    swapped = ~close & (strength[1] > strength[0])
    between = np.where(close, own, 0) + weight * np.where(close, far - own, 0)
    ranges = np.where(close, between, np.where(swapped, far, own))
    light = np.where(close, np.float32(1.0), np.where(swapped, share, 1 - share))
    source = np.where(swapped, other, ray)
    changed = {
        "object_ids": hits.object_ids[source],
        "reflectance": hits.reflectance[source] * light,
        "cosines": hits.cosines[source],
    }
    hits.ranges[ray] = ranges
    for name, values in changed.items():
        getattr(hits, name)[ray] = values


def _beams_on_edges(
    hits: Hits, ways: Float32, stride: int, divergence: float, rng: np.random.Generator
) -> tuple[Int64, Int64, Float32]:
    """Rays that reach over an edge, the ray on its other side, and the share of light from there.

    At most one edge a ray.
    """
    rays, others, shares = [], [], []
    for step, gaps in ((1, _between_beams), (stride, _between_firings)):
        first, edge, apart = gaps(hits.ranges, ways, stride, divergence, rng)
        kept = _edges(hits, ways, first, first + step)
        first, edge, apart = first[kept], edge[kept], apart[kept]
        rays += [first, first + step]
        others += [first + step, first]
        shares += [0.5 - edge / divergence, 0.5 - (apart - edge) / divergence]
    ray, other, share = np.concatenate(rays), np.concatenate(others), np.concatenate(shares)
    over = np.flatnonzero(share > 0)
    _, once = np.unique(ray[over], return_index=True)
    chosen = over[once]
    return ray[chosen], other[chosen], share[chosen].astype(np.float32)


def _between_beams(
    ranges: Float32, ways: Float32, stride: int, divergence: float, rng: np.random.Generator
) -> tuple[Int64, Float32, Float32]:
    """Where ranges jump from one beam of a firing to the next, and a cone reaches a drawn edge.

    Returns the first of the two rays, the angle from it to the edge and that to the second ray.
    The beams of a firing keep their angles to each other.
    """
    table = ranges.reshape(-1, stride)
    fan = _angles(ways[:stride], np.arange(stride - 1), 1)
    edge = rng.random((len(table), stride - 1), dtype=np.float32) * fan
    found = _jumps(table[:, 1:], table[:, :-1])
    found &= np.minimum(edge, fan - edge) < divergence / 2
    firing, beam = np.nonzero(found)
    return firing * stride + beam, edge[firing, beam], fan[beam]


def _between_firings(
    ranges: Float32, ways: Float32, stride: int, divergence: float, rng: np.random.Generator
) -> tuple[Int64, Float32, Float32]:
    """The same for one beam from one firing to the next."""
    first = np.flatnonzero(_jumps(ranges[stride:], ranges[:-stride]))
    apart = _angles(ways, first, stride)
    edge = rng.random(len(first), dtype=np.float32) * apart
    near = np.flatnonzero(np.minimum(edge, apart - edge) < divergence / 2)
    return first[near], edge[near], apart[near]


def _jumps(ranges: Float32, others: Float32) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):  # infinity less infinity is no jump
        return np.asarray(np.abs(ranges - others) > _JUMP_M)


def _angles(ways: Float32, first: Int64, step: int) -> Float32:
    """Small angles between rays and those ``step`` further on, radians."""
    chord = ways.take(first + step, axis=0) - ways.take(first, axis=0)
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", chord, chord)))


def _edges(hits: Hits, ways: Float32, first: Int64, second: Int64) -> NDArray[np.bool_]:
    """Whether two rays meet surfaces of which neither continues the other."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        edges = ~_continues(hits, ways, first, second)
        left = np.flatnonzero(edges)
        edges[left] = ~_continues(hits, ways, second[left], first[left])
    return edges


def _continues(hits: Hits, ways: Float32, ray: Int64, other: Int64) -> NDArray[np.bool_]:
    """Whether the other ray meets the plane in which this one's surface lies."""
    normal = hits.normals.take(ray, axis=0)
    here = np.einsum("ij,ij->i", normal, ways.take(ray, axis=0))
    there = np.einsum("ij,ij->i", normal, ways.take(other, axis=0))
    expected = hits.ranges[ray] * here / there
    return np.asarray(np.abs(expected - hits.ranges[other]) < _JUMP_M)


def _strength(hits: Hits, ray: Int64) -> Float32:
    return hits.reflectance[ray] * hits.cosines[ray] / hits.ranges[ray] ** 2
