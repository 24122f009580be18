"""Update a map with a later session of the same place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from ..errors import MapMismatch, SeglocError
from ..map.build import build_map
from ..map.compact import CompactConfig, compacted
from ..map.config import BuildConfig, stored_config, stored_text
from ..map.segment_map import SegmentMap
from ..system.section import Section
from ..types import Bools, Float64, Recording, Scanned, as_recording
from .same_place import check_same_place
from .shift import TO_THE_FRAME, Shift, check_shift
from .visibility import Visibility, VisibilityConfig, visibility

Int32 = NDArray[np.int32]

_POINT_AREA_M2 = 0.04  # surface per point of a segment: voxels of 0.2 m
_RADII_M = (0.5, 2.5)
_MIN_POINTS = 4


class UpdateConfig(Section):
    """How long a map keeps objects that are gone, and its maximum size."""

    max_missed: int = Field(
        2, ge=1, description="sessions in a row that must pass through an object to remove it"
    )
    gone_share: float = Field(
        0.6, gt=0, le=1, description="share of an object's points in view that must be gone"
    )
    max_gone: float = Field(
        0.25, gt=0, le=1, description="share of the visible map above which removal is refused"
    )
    max_views: int | None = Field(
        None,
        ge=0,
        description="newest views kept of an object; 0: all; by default twice those of a session",
    )
    same_m: float = Field(0.5, gt=0, description="distance between centroids of one object, metres")
    max_segments: int = Field(0, ge=0, description="maximum number of segments; 0: unlimited")
    visibility: VisibilityConfig = VisibilityConfig()


@dataclass(frozen=True)
class UpdateCounts:
    """Counts of an update.

    Attributes
    ----------
    added : int
        Segments of the new session.
    seen, aged, removed, out_of_view : int
        Segments of the old map: still there; missing, but not for long enough; removed; not
        in view.
    bounded : int
        Segments dropped to keep the size bounded.
    points_removed : int
        Points removed from the cloud.
    shift : Shift or None
        Of the session against the map; None if not measured.
    """

    added: int
    seen: int
    aged: int
    removed: int
    out_of_view: int
    bounded: int
    points_removed: int
    shift: Shift | None = None


def update_map(
    prior_map: SegmentMap,
    scans: Scanned,
    config: BuildConfig | None = None,
    update: UpdateConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    elsewhere: bool = False,
    unchecked: bool = False,
    shift: Shift | None = None,
) -> tuple[SegmentMap, UpdateCounts]:
    """Add a session to a map, and remove objects that are gone.

    An object is missed if rays of the session pass through it and none ends on it. After
    ``max_missed`` sessions in a row it is removed with its points; seeing it resets the count, and
    occlusion leaves it unchanged. Points outside objects are removed at once.

    Parameters
    ----------
    prior_map : SegmentMap
    scans : Recording, or list of Scan
        The session; its poses are T_map_sensor.
    config : BuildConfig, optional
        Configuration of the session; by default the map's.
    update : UpdateConfig, optional
    progress : callable, optional
        Called with (scans done, total) while visibility is computed.
    elsewhere : bool
        True to allow a session of another place in the map's frame; see
        :func:`~segloc.joining.same_place.check_same_place`.
    unchecked : bool
        True to add the session even if its poses do not fit the map.
    shift : Shift, optional
        As measured by :func:`~segloc.joining.shift.check_shift`; by default measured here.

    Raises
    ------
    DatasetError
        If the recording has no poses or no segments.
    MapMismatch
        If the map has another descriptor, the session's poses are off the map (see
        :func:`~segloc.joining.shift.check_shift`), it does not meet the map, or their clouds
        disagree.
    SeglocError
        If too much of the visible map is gone, so that the poses are probably in another frame.
    """
    update, recording = update or UpdateConfig(), as_recording(scans)
    if shift is None and not unchecked:
        shift = check_shift(prior_map, recording, config, name=recording.name)
    visible = visibility(prior_map.cloud, prior_map.origin, recording, update.visibility, progress)
    if not unchecked:
        _check_frame(visible, recording.name, update.max_gone)
    gone, seen = _classify_segments(prior_map, visible, update.gone_share)
    missed = np.where(gone, prior_map.missed + 1, ~seen * prior_map.missed).astype(np.int32)
    fresh, compact = _session_map(prior_map, recording, config)
    try:
        check_same_place(prior_map, fresh, elsewhere=elsewhere, unchecked=unchecked)
    except MapMismatch as error:
        raise MapMismatch(f"{recording.name}: {error}. {TO_THE_FRAME}") from error
    stay = missed < update.max_missed
    waiting = stay & gone
    points = ~visible.gone | _within_segments(prior_map, waiting)
    # What goes is merged, too: its session's number is not free.
    merged = prior_map.kept(np.ones(len(prior_map), dtype=bool), points, missed).merge(fresh)
    rows = np.concatenate([stay, np.ones(len(merged) - len(stay), dtype=bool)])
    merged = merged.kept(rows, np.ones(len(merged.cloud), dtype=bool))
    most = 2 * compact.max_views * compact.enabled if update.max_views is None else update.max_views
    newest = _newest_views(merged, most, update)
    bounded = merged.kept(newest, np.ones(len(merged.cloud), dtype=bool))
    updated = compacted(bounded, compact)
    return updated, UpdateCounts(
        added=len(fresh),
        seen=int(seen.sum()),
        aged=int(waiting.sum()),
        removed=int((~stay).sum()),
        out_of_view=int((~gone & ~seen).sum()),
        bounded=len(merged) - len(updated),
        points_removed=int((~points).sum()),
        shift=shift,
    )


def _session_map(
    prior_map: SegmentMap, recording: Recording, config: BuildConfig | None
) -> tuple[SegmentMap, CompactConfig]:
    """Build the map of a session; also return how to compact it."""
    built = config or stored_config(prior_map, BuildConfig)
    # The session's poses are in the map's frame, which is level already.
    as_posed = built.mapping.model_copy(update={"level": False})
    fresh = build_map(recording, built.model_copy(update={"mapping": as_posed}), adapt=False)
    whole = built.model_copy(update={"threads": 0}).to_yaml()  # maps do not depend on the threads
    text = stored_text(prior_map) if config is None else ""
    fresh.metadata["config"] = text or whole  # one text, not a part beside the whole
    return fresh, built.mapping.compact


def _check_frame(visible: Visibility, name: str, max_gone: float) -> None:
    gone, seen = int(visible.gone.sum()), int(visible.seen.sum())
    if gone > max_gone * (gone + seen):
        share = 100 * gone / (gone + seen)
        raise SeglocError(
            f"{name}: {share:.0f} % of the visible map is gone: are its poses in the map's frame? "
            f"{TO_THE_FRAME}"
        )


def _radii(prior_map: SegmentMap) -> Float64:
    """Return each segment's radius, as of a sphere with its surface area."""
    reach = 0.2 + 1.3 * np.sqrt(prior_map.sizes * _POINT_AREA_M2 / (4 * np.pi))
    radii: Float64 = np.clip(reach, *_RADII_M)
    return radii


def _classify_segments(
    prior_map: SegmentMap, visible: Visibility, gone_share: float
) -> tuple[Bools, Bools]:
    """Return which segments are gone and which were seen; neither if too little was in view."""
    rows = np.flatnonzero(visible.gone | visible.seen)
    if not len(rows) or not len(prior_map):
        return np.zeros(len(prior_map), dtype=bool), np.zeros(len(prior_map), dtype=bool)
    tree = cKDTree(prior_map.cloud[rows] + prior_map.origin)
    members = tree.query_ball_point(prior_map.centroids, _radii(prior_map))
    counts = np.array([len(each) for each in members])
    lost = np.array([np.count_nonzero(visible.gone[rows[each]]) for each in members])
    in_view = counts >= _MIN_POINTS
    gone = in_view & (lost >= gone_share * counts)
    return gone, in_view & ~gone


def _within_segments(prior_map: SegmentMap, chosen: Bools) -> Bools:
    """Return which points of the cloud belong to chosen segments."""
    inside = np.zeros(len(prior_map.cloud), dtype=bool)
    if chosen.any():
        tree = cKDTree(prior_map.cloud + prior_map.origin)
        for members in tree.query_ball_point(
            prior_map.centroids[chosen], _radii(prior_map)[chosen]
        ):
            inside[members] = True
    return inside


def _newest_views(prior_map: SegmentMap, max_views: int, update: UpdateConfig) -> Bools:
    """Return which segments stay within the limits of views per object and of segments."""
    keep = np.ones(len(prior_map), dtype=bool)
    newest = np.lexsort((prior_map.stamps, prior_map.session, -prior_map.missed))[::-1]
    if max_views:
        near = cKDTree(prior_map.centroids).query_ball_point(prior_map.centroids, update.same_m)
        keep[:] = False
        for i in newest:
            keep[i] = np.count_nonzero(keep[near[i]]) < max_views
    if update.max_segments:
        keep[newest[keep[newest]][update.max_segments :]] = False
    return keep
