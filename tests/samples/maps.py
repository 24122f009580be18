"""Small maps that need nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from segloc import Localizer
from segloc.geometry import yaw_transform
from segloc.map.segment_map import SegmentMap
from segloc.proposals.occupancy import OccupancyProposer
from segloc.types import Descriptors


def make_map(
    views: int = 2, *, segments: int = 3, quality: bool = True, seed: int = 0
) -> SegmentMap:
    """Random segments and points, far from the origin of the frame."""
    rng = np.random.default_rng(seed)
    prior_map = SegmentMap.empty("geo", "f" * 16, 5, (4e5, 5e6, 300.0), cloud_voxel=0.25)
    prior_map.metadata["config"] = "voxel: 0.2\nname: Zürich\n"
    for view in range(views):
        prior_map.add(
            Descriptors(
                rng.normal(size=(segments, 5)).astype(np.float32),
                rng.uniform(size=segments).astype(np.float32) if quality else None,
            ),
            prior_map.origin + rng.normal(size=(segments, 3)),
            rng.integers(1, 99, segments),
            session=view,
            stamp=view / 7,
            cloud=prior_map.origin + rng.normal(size=(20, 3)),
        )
        prior_map.add_trajectory(np.eye(4)[None])
    return prior_map


def repeated(prior_map: SegmentMap, *shifts: ArrayLike) -> SegmentMap:
    """A place, and the same place once more at each shift."""
    whole = prior_map
    for k, shift in enumerate(np.asarray(shifts, dtype=np.float64)):
        other = SegmentMap.empty(
            prior_map.descriptor, prior_map.fingerprint, prior_map.dim, prior_map.origin,
            cloud_voxel=prior_map.cloud_voxel,
        )  # fmt: skip
        other.add(
            Descriptors(prior_map.vectors, prior_map.quality), prior_map.centroids + shift,
            prior_map.sizes, session=k + 1, stamp=k + 1.0,
            cloud=prior_map.cloud + prior_map.origin + shift,
        )  # fmt: skip
        path = prior_map.trajectory.copy()
        path[:, :3, 3] += shift
        other.add_trajectory(path)
        whole = whole.merge(other)
    whole.metadata.update(prior_map.metadata)
    return whole


def town(
    count: int = 900,
    points: int = 6000,
    seed: int = 0,
    quality: bool = True,
    origin: ArrayLike = (4e5, 5e6, 300.0),
) -> SegmentMap:
    """Segments in small heaps, as views of objects are, and a cloud of some walls."""
    rng = np.random.default_rng(seed)
    origin = np.array(origin)
    made = SegmentMap.empty("geo", "f" * 16, 7, origin)
    places = np.repeat(rng.uniform(-60, 60, (count // 9, 3)), 3, axis=0)
    for view in range(3):
        described = Descriptors(
            (rng.normal(size=(len(places), 7)) * [1, 1, 1, 40, 0.02, 1, 1]).astype(np.float32),
            rng.uniform(size=len(places)).astype(np.float32) if quality else None,
        )
        cloud = rng.uniform(-60, 60, (points // 3, 3))
        cloud[:, 0] = np.round(cloud[:, 0] / 20) * 20 + 0.07
        made.add(
            described,
            origin + places + rng.normal(0, 0.1, places.shape),
            rng.integers(30, 9000, len(places)),
            session=view // 2,
            stamp=1.6e9 + view / 7,
            cloud=origin + cloud,
        )
        made.add_trajectory(yaw_transform(view, (4e5 + view / 3, 5e6, 301.0))[None])
    return made


def occupancy(localizer: Localizer) -> OccupancyProposer:
    """The proposer of a localizer that searches by occupancy."""
    return next(p for p in localizer.proposers if isinstance(p, OccupancyProposer))
