"""Local cloud -> candidate poses at the mapping sensor's own places, by the view all around.

Each place has a polar image: what is occupied in each direction, at each distance, at each height.
The view of a query is turned until it fits; correlations are computed by Fourier transform, as in
X. Xu et al., "RING++: Roto-translation Invariant Gram for Global Localization on a Sparse Scan
Map", IEEE Transactions on Robotics 2023, of an image as in G. Kim, A. Kim, "Scan Context:
Egocentric Spatial Descriptor for Place Recognition Within 3D Point Cloud Map", IROS 2018.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import fft

from .. import _native, geometry
from ..frontend.segmentation import SegmentationConfig
from ..map.segment_map import SegmentMap
from ..prior import Prior, within
from ..system.section import Section
from ..types import Candidate, Float32, Float64
from .occupancy import Ground, OccupancyConfig, ground_of, is_storeyed
from .proposer import Query
from .view import HEIGHTS_M, Bytes, evenly, slices_of

_SECTORS, _FREQUENCIES = 64, 16
"""Directions of a polar image, and its frequencies that are compared."""
_RING_M, _RINGS = 1.5, 20
"""Width of its rings, and their number."""
_BAND = 2
"""Height slices of occupancy in one of its bands."""
_SPACING_M, _MOST_PLACES = 2.0, 4000
"""Spacing of places along the mapping sensor's path, and the most of a map, for memory and time."""
_TRIED = 16
"""Places by which it is told whether a map has any that are unlike the others."""
_MOST_POINTS = 4000
"""Points by whose directions it is told whether a view is one all around."""
_APART_M, _APART_DEG = 15.0, 45.0
"""Separation of views that would be alike by chance."""
_TOGETHER = 256
"""Images that are transformed at once."""

Image = NDArray[np.complex64]


class FirstSightConfig(Section):
    """Search by the view all around, before segments are matched."""

    enabled: bool = Field(
        True,
        description="before segments are matched, localize by the view all around, if no other "
        "place of the map looks alike; needs `occupancy.enabled`",
    )
    fit: float = Field(
        0.3, ge=0, le=1, description="least correlation of the view with that from a place"
    )
    alike: float = Field(
        0.45,
        ge=0,
        le=1,
        description="highest correlation of the view from a place with others, or mirror images",
    )
    """Chosen on 34 simulated worlds: where a view and the clouds misled, it was 0.52 and more."""
    all_around: float = Field(
        0.9, ge=0, le=1, description="least share of the directions that the query sees"
    )


class FirstSight:
    """Proposes the place of the mapping sensor whose view is most like that of the query.

    Nothing is proposed to a query that does not look all around; nor if that place looks like
    another one, or like the mirror image of one: there a view alone does not tell places apart.

    Parameters
    ----------
    prior_map : SegmentMap
    config : FirstSightConfig
    occupancy : OccupancyConfig
        Definition of what is occupied.
    segmentation : SegmentationConfig
        Definition of ground.
    threads : int
        0 is all cores; results do not depend on it.

    Notes
    -----
    The first query computes the images of the map: about 0.25 s and 5 MB a kilometre. Maps of more
    than about 8 km, of several storeys, without ground or without a path have none.
    """

    def __init__(
        self,
        prior_map: SegmentMap,
        config: FirstSightConfig,
        occupancy: OccupancyConfig,
        segmentation: SegmentationConfig,
        threads: int = 0,
    ) -> None:
        self.config, self._threads = config, threads
        self._map, self._occupancy, self._segmentation = prior_map, occupancy, segmentation
        self._places: _Places | None = None
        self._is_prepared = False

    name = "first sight"

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        """Propose a pose T_map_local with its correlation as ``fit``, or none."""
        if not self._looks_around(query.scene.surface):  # no images for a sensor that never does
            return []
        places = self._prepared()
        if places is None:
            return []
        view = query.view(self._occupancy.cell, self._occupancy.range_m, self._segmentation)
        best, turn, fit = places.most_like(view.columns, view.slices)
        if fit < self.config.fit or places.likeness(best) > self.config.alike:
            return []
        T = places.pose(best, turn, view.below)
        return within(prior, [Candidate(T, 0, fit)])

    def _looks_around(self, points: Float32) -> bool:
        """Return whether a view has points in nearly all directions."""
        some = points[:: 1 + len(points) // _MOST_POINTS]
        return len(np.unique(_sectors(some))) >= self.config.all_around * _SECTORS

    def _prepared(self) -> _Places | None:
        """Compute the images of all places, once; None if the places of the map look alike."""
        if not self._is_prepared:  # concurrent callers compute them twice, harmlessly
            places = _Places(self._map, self._occupancy, self._segmentation, self._threads)
            some = evenly(len(places), _TRIED)
            if any(places.likeness(int(k)) <= self.config.alike for k in some):
                self._places = places
            self._is_prepared = True
        return self._places


class _Places:
    """Places of the mapping sensor, and what is seen from them."""

    def __init__(
        self,
        prior_map: SegmentMap,
        occupancy: OccupancyConfig,
        segmentation: SegmentationConfig,
        threads: int,
    ) -> None:
        self._origin = prior_map.voxel_cloud.origin
        path = prior_map.trajectory[:, :3, 3] - self._origin
        self._ground: Ground | None = None
        self._at = path[:0]
        places = geometry.spaced(path, _SPACING_M)
        if not 0 < len(places) <= _MOST_PLACES or not prior_map.has_ground or is_storeyed(path):
            return
        cloud = _native.voxel_grid(prior_map.voxel_cloud.points, occupancy.cell)
        self._ground, below = ground_of(cloud, path, segmentation)
        heights = cloud[:, 2] - below
        above = heights > HEIGHTS_M[0]
        xy, slices = cloud[above, :2], slices_of(heights[above])
        if not len(xy):
            return
        self._at = places
        images = polar_images(xy, slices, places[:, :2].astype(np.float32), threads)
        self._spectra = _spectra(images)
        self._likeness = np.full(len(self._at), np.nan)

    def __len__(self) -> int:
        return len(self._at)

    def most_like(self, centres: Float32, slices: Bytes) -> tuple[int, float, float]:
        """Return the place whose view is most like one, the turn to it [rad], and how much."""
        image = polar_images(centres, slices, np.zeros((1, 2), np.float32), 1)
        correlation = self._correlation(np.conj(_spectra(image)))
        turn, best = np.unravel_index(int(correlation.argmax()), correlation.shape)
        fit = float(correlation[turn, best])
        return int(best), 2.0 * np.pi / _SECTORS * float(turn), fit

    def _correlation(self, image: Image) -> Float32:
        """Return the correlation with each place at all turns, (sectors, places)."""
        product = np.zeros((_SECTORS // 2 + 1, len(self)), np.complex64)
        # Not by BLAS, whose threads would wait for each other longer than they work.
        product[1 : 1 + _FREQUENCIES] = np.einsum("fpc,fc->fp", self._spectra, image[:, 0])
        found: Float32 = fft.irfft(product, n=_SECTORS, axis=0)
        return found

    def likeness(self, k: int) -> float:
        """Return the highest correlation of a place's view with others and with mirror images."""
        if np.isnan(self._likeness[k]):
            own = self._spectra[:, k : k + 1]
            turned = np.abs((np.arange(_SECTORS) * 360.0 / _SECTORS + 180.0) % 360.0 - 180.0)
            beside = np.linalg.norm(self._at - self._at[k], axis=1) < _APART_M
            other = self._correlation(np.conj(own))
            other[np.ix_(turned < _APART_DEG, beside)] = 0.0
            self._likeness[k] = max(other.max(), self._correlation(own).max())
        return float(self._likeness[k])

    def pose(self, k: int, turn: float, below: float) -> Float64:
        """Return the pose T_map_local at a place, of a view whose ground is at height ``below``."""
        assert self._ground is not None
        x, y = self._at[k, :2]
        z = self._ground.below(self._at[k : k + 1, :2])[0] - below
        return geometry.yaw_transform(turn, tuple(self._origin + (x, y, z)))


def polar_images(
    centres: Float32, slices: Bytes, places: Float32, threads: int
) -> NDArray[np.uint8]:
    """Return what is occupied around places, (P, rings, bands, sectors): 1 in a cell, and else 0.

    Parameters
    ----------
    centres : (N, 2) float32
        Occupied cells [m].
    slices : (N,) uint8
        Occupied height slices of each, as bits.
    places : (P, 2) float32
    threads : int
        0 is all cores; results do not depend on it.
    """
    bands, cells = len(HEIGHTS_M) // _BAND, np.ascontiguousarray(centres)
    return _native.polar_images(
        cells, slices, places, _RING_M, _RINGS, bands, _SECTORS, threads=threads
    )


def _sectors(points: Float32) -> NDArray[np.int64]:
    """Return the direction of each of (N, 2) or (N, 3) points, (N,)."""
    angle = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi)
    sectors: NDArray[np.int64] = np.floor(_SECTORS * angle).astype(np.int64) % _SECTORS
    return sectors


def _spectra(images: NDArray[np.uint8]) -> Image:
    """Return (N, ...) images by frequency of direction, (frequencies, N, cells), of length 1.

    Their product with a conjugate one is, by frequency, the correlation of what varies with
    direction.
    """
    found = np.empty((_FREQUENCIES, len(images), images[0, ..., 0].size), np.complex64)
    for begin in range(0, len(images), _TOGETHER):  # bounds the memory
        some = images[begin : begin + _TOGETHER].astype(np.float32)
        spectra = fft.rfft(some, axis=-1)[..., 1 : 1 + _FREQUENCIES].reshape(
            len(some), -1, _FREQUENCIES
        )
        norm = np.sqrt(2.0 / _SECTORS * (np.abs(spectra) ** 2).sum(axis=(1, 2), keepdims=True))
        spectra /= np.maximum(norm, 1e-6)
        found[:, begin : begin + len(some)] = spectra.transpose(2, 0, 1)
    return found
