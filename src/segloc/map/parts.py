"""Maps put together of parts that share nothing, and along other paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import MapMismatch
from ..types import Float64
from .merge import union_of_texts
from .segment_map import SegmentMap
from .voxel_cloud import VoxelCloud


def along(prior_map: SegmentMap, path: Float64) -> SegmentMap:
    """The same map with another path of (V, 4, 4) poses."""
    cloud = VoxelCloud(prior_map.cloud, prior_map.origin, prior_map.cloud_voxel)
    named = prior_map.descriptor, prior_map.fingerprint
    return SegmentMap(*named, prior_map.columns(), cloud, path, prior_map.metadata)


def concatenated(parts: list[SegmentMap], *, apart: bool = False) -> SegmentMap:
    """Maps of one frame, one behind the other; rows of several are kept as often.

    With ``apart`` no voxel is in two of them, as is known of parts of one map: their points are not
    compared, which takes most of the time and memory, where they are relative to one origin.

    Raises
    ------
    MapMismatch
        If they were made by different descriptors, or their clouds lie on different grids.
    """
    first = parts[0]
    for part in parts[1:]:
        if (part.descriptor, part.fingerprint) != (first.descriptor, first.fingerprint):
            raise MapMismatch(
                f"parts made by {first.descriptor!r} ({first.fingerprint}) and "
                f"{part.descriptor!r} ({part.fingerprint}) are of no one map"
            )
        if part.cloud_voxel != first.cloud_voxel:
            raise MapMismatch("the clouds of the parts have voxels of different sizes")
    filled = [part for part in parts if len(part)] or [first]
    columns = [part.columns() for part in filled]
    if any(each.keys() != columns[0].keys() for each in columns):
        raise MapMismatch("some parts have descriptor quality and some have none")
    texts = dict(first.metadata)
    for part in parts[1:]:
        texts = union_of_texts(texts, part.metadata)
    return SegmentMap(
        first.descriptor,
        first.fingerprint,
        {name: np.concatenate([each[name] for each in columns]) for name in columns[0]},
        _clouds(parts, apart),
        np.concatenate([part.trajectory for part in parts]),
        texts,
    )


def _clouds(parts: list[SegmentMap], apart: bool) -> VoxelCloud:
    first = parts[0]
    if apart and all(np.array_equal(part.origin, first.origin) for part in parts):
        points = np.concatenate([part.cloud for part in parts])
        return VoxelCloud(points, first.origin, first.cloud_voxel)
    cloud = VoxelCloud(first.cloud, first.origin, first.cloud_voxel)
    for part in parts[1:]:
        own = VoxelCloud(part.cloud, part.origin, part.cloud_voxel)
        cloud.add_relative(own.moved_to(first.origin, first.cloud_voxel).points)
    return cloud


def with_sessions(prior_map: SegmentMap, session: NDArray[np.int32]) -> SegmentMap:
    """The same map with other numbers of sessions, (P,)."""
    cloud = VoxelCloud(prior_map.cloud, prior_map.origin, prior_map.cloud_voxel)
    columns = {**prior_map.columns(), "session": session}
    named = prior_map.descriptor, prior_map.fingerprint
    return SegmentMap(*named, columns, cloud, prior_map.trajectory, prior_map.metadata)
