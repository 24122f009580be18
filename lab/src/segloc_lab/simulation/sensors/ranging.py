"""What every simulated LiDAR shares: range noise, lost and mixed returns, glass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from segloc.errors import ConfigError
from segloc.types import Float32, Float64, Int64, Pose

from ..objects.mesh import GLASS, Int32
from ..objects.scene import Hits, Scene

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
    hits.ranges[ray] = ranges
    hits.object_ids[ray] = hits.object_ids[source]
    hits.reflectance[ray] = hits.reflectance[source] * light
    hits.cosines[ray] = hits.cosines[source]


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


_DIRTY, _MIRRORED = 0.25, 0.02  # shares of the panes
_THROUGH_TWICE, _MIRRORED_TWICE = 0.7, 0.03  # of the light, there and back
_SKIN = 2e-3  # where a ray goes on behind a pane, metres

Self = TypeVar("Self", bound="Lidar")
PosesAt: TypeAlias = Callable[[Float64], Float64]


class Rays(NamedTuple):
    """The rays of one scan: F firings of B beams each, one firing after another.

    Attributes
    ----------
    directions : (F * B, 3) float32
        Unit vectors, sensor frame.
    times : (F,) float64
        When each firing is, seconds from the start of the scan; rising.
    """

    directions: Float32
    times: Float64

    @property
    def beams_a_firing(self) -> int:
        return len(self.directions) // len(self.times)


def directions(azimuth: Float64, elevation: Float64) -> Float32:
    """Unit vectors (n, 3) of angles that broadcast, radians."""
    flat = np.cos(elevation)
    ways = np.broadcast_arrays(np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation))
    return np.stack(ways, axis=-1).reshape(-1, 3).astype(np.float32)


class Returns(NamedTuple):
    """What a sensor reports of one scan.

    Attributes
    ----------
    points : (N, 3) float32
        Metres, in the frame that the sensor has when it takes each point.
    object_ids : (N,) int32
        Which object each point lies on; -1 for ghosts, which were mirrored by glass.
    times : (N,) float64
        Seconds from the start of the scan.
    """

    points: Float32
    object_ids: Int32
    times: Float64


@dataclass(frozen=True, kw_only=True)
class Lidar(ABC):
    """A LiDAR: rays from one origin, and what becomes of them.

    A return of reflectance rho at range r and angle of incidence theta is found with probability
    1 / (1 + s**-4). Its strength relative to the detection threshold is
    s = rho * cos(theta)**incidence_exponent * (reference_range_m / r)**2. The exponent is below one
    because rough surfaces send light back at grazing angles too.

    Of the panes of glass a quarter are dirty enough to be seen. A few mirror the rays, which then
    report what they meet next as if it lay behind the glass (often below the ground). Through all
    others the sensor sees what is behind, if anything.

    A beam is a cone. Where it meets an edge, the sensor gets light back from both sides of it and
    reports the stronger echo, or a point between the two where they are too close to tell apart.

    Attributes
    ----------
    min_range_m, max_range_m : float
        Returns outside are not reported.
    range_sigma_m : float
        Standard deviation of a range.
    beam_bias_sigma_m : float
        Standard deviation, over the beams, of the error that each beam makes all the time.
    reference_range_m : float
        Where a white surface square to the beam is still found half of the time; infinite for a
        sensor that loses nothing.
    glass : bool
        Whether glass is glass, or like any other surface.
    divergence_mrad : float
        Opening angle of a beam; 0 for rays without width.
    rate_hz : float
        Scans a second.
    mount_height_m : float
        Of the sensor above the ground.
    unit : int
        Serial number: which beams are biased how.
    """

    name: str
    min_range_m: float = 1.0
    max_range_m: float = 120.0
    range_sigma_m: float = 0.02
    beam_bias_sigma_m: float = 0.005
    reference_range_m: float = 200.0
    incidence_exponent: float = 0.35
    glass: bool = True
    divergence_mrad: float = 3.0
    rate_hz: float = 10.0
    mount_height_m: float = 1.73
    unit: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.min_range_m < self.max_range_m:
            span = f"{self.min_range_m}, {self.max_range_m}"
            raise ConfigError(f"min_range_m and max_range_m must rise from 0, not {span}")
        not_negative = ("range_sigma_m", "beam_bias_sigma_m", "incidence_exponent")
        for name in (*not_negative, "divergence_mrad", "unit"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name} must not be negative, not {getattr(self, name)}")
        for name in ("reference_range_m", "mount_height_m", "rate_hz"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")

    @abstractmethod
    def rays(self, phase: float, number: int = 0) -> Rays:
        """The rays of a scan.

        Parameters
        ----------
        phase : float
            In [0, 1): where the pattern starts, for sensors that start anywhere.
        number : int
            How many scans went before, for sensors whose pattern goes on from scan to scan.
        """

    @abstractmethod
    def thinned(self: Self, factor: int) -> Self:
        """The same sensor with about every ``factor``-th firing: faster scans of fewer points."""

    @staticmethod
    def _fewer(firings: int, factor: int, least: int) -> int:
        if factor < 1:
            raise ConfigError(f"factor must be at least 1, not {factor}")
        return max(least, round(firings / factor))

    def ideal(self: Self) -> Self:
        """The same rays without noise, lost or mixed returns, or glass."""
        return replace(
            self,
            range_sigma_m=0.0,
            beam_bias_sigma_m=0.0,
            reference_range_m=np.inf,
            glass=False,
            divergence_mrad=0.0,
        )

    def scan(
        self, scene: Scene, T_world_sensor: Pose, rng: np.random.Generator
    ) -> tuple[Float32, Int32]:
        """Points and object ids of one scan from a sensor at rest, as :meth:`take` has them."""
        returns = self.take(scene, T_world_sensor, rng)
        return returns.points, returns.object_ids

    def take(
        self,
        scene: Scene,
        T_world_sensor: Pose | PosesAt,
        rng: np.random.Generator,
        number: int = 0,
    ) -> Returns:
        """One scan, from a sensor at rest or from one that moves while it scans.

        Parameters
        ----------
        T_world_sensor : (4, 4) float64, or callable
            Of a sensor that moves: the poses (F, 4, 4) at times (F,), seconds from the start of
            the scan.
        rng : Generator
            Decides phase, noise and lost returns; the same state gives the same scan.
        number : int
            How many scans went before.
        """
        rays = self.rays(rng.random(), number)
        poses = T_world_sensor(rays.times) if callable(T_world_sensor) else T_world_sensor
        T = np.asarray(poses, dtype=np.float32).reshape(-1, 4, 4)  # one, or one a firing
        local = rays.directions.reshape(len(rays.times), -1, 3)
        ways = local @ T[:, :3, :3].transpose(0, 2, 1)
        origins = np.broadcast_to(T[:, None, :3, 3], ways.shape).reshape(-1, 3)
        ways = ways.reshape(-1, 3)
        hits = scene.cast(origins, ways, self.max_range_m)
        if self.glass:
            self._meet_glass(scene, origins, ways, hits)
        beams = rays.beams_a_firing
        noise = rng.standard_normal((len(rays.times), beams), dtype=np.float32)
        noise *= np.float32(self.range_sigma_m)
        bias = np.random.default_rng([self.unit, 23]).normal(0.0, self.beam_bias_sigma_m, beams)
        noise += bias.astype(np.float32)
        draw = rng.random(len(ways), dtype=np.float32)
        if self.divergence_mrad > 0:
            mix_echoes(hits, ways, beams, self.divergence_mrad / 1000, rng)
        measured = hits.ranges + noise.reshape(-1)
        kept = self._returned(hits, draw)
        kept &= (measured >= self.min_range_m) & (measured <= self.max_range_m)
        found = np.flatnonzero(kept)
        return Returns(
            rays.directions[found] * measured[found, None],
            hits.object_ids[found],
            rays.times[found // beams],
        )

    def _meet_glass(self, scene: Scene, origins: Float32, ways: Float32, hits: Hits) -> None:
        """Follow rays through panes or off them; changes ``hits`` in place."""
        pane = np.flatnonzero(hits.material == GLASS)
        kind = hits.lots[pane]
        pane, kind = pane[kind > _DIRTY], kind[kind > _DIRTY]
        mirrored = kind > 1 - _MIRRORED
        way, normal = ways[pane], hits.normals[pane]
        bounced = way - 2 * np.einsum("ij,ij->i", way, normal)[:, None] * normal
        onward = np.where(mirrored[:, None], bounced, way).astype(np.float32)
        start = origins[pane] + way * hits.ranges[pane, None] + onward * np.float32(_SKIN)
        behind = scene.cast(start, onward, self.max_range_m)
        lost = behind.material == GLASS
        left = np.where(mirrored, np.float32(_MIRRORED_TWICE), np.float32(_THROUGH_TWICE))
        hits.ranges[pane] += np.where(lost, np.float32(np.inf), behind.ranges + np.float32(_SKIN))
        hits.object_ids[pane] = np.where(mirrored, -1, behind.object_ids)
        hits.reflectance[pane] = behind.reflectance * left
        hits.cosines[pane] = behind.cosines
        hits.normals[pane] = behind.normals

    def _returned(self, hits: Hits, draw: Float32) -> NDArray[np.bool_]:
        found = np.isfinite(hits.ranges)
        if np.isinf(self.reference_range_m):
            return found
        far = np.where(found, hits.ranges, np.float32(1.0)) / np.float32(self.reference_range_m)
        strength = hits.reflectance * hits.cosines ** np.float32(self.incidence_exponent) / far**2
        square = np.clip(strength, np.float32(1e-4), np.float32(1e4)) ** 2
        return np.asarray(found & (draw * (1 + 1 / square**2) < 1))
