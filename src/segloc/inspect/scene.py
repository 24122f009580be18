"""Draw a map, queries and one query in detail as a scene of viser."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import geometry
from ..map.segment_map import SegmentMap
from ..types import Float32, Float64
from .pictures import BLUE, GREEN, ORANGE, PATH, RED, hue, rgb
from .results import Outcome, Shown, Stages

Colors = NDArray[np.uint8]

COLOURS: dict[Outcome, str] = {"found": GREEN, "refused": ORANGE, "false": RED}
FIXED = ("map", "path", "queries")
ROBOT = ("map", "path", "robot")
OF_QUERY = ("cloud", "segments", "matches that agree", "other matches", "runner-up", "text")
"""Layers that can be hidden: of the map, of a map with a robot, of the selected query."""
_LOW, _HIGH = np.array([126.0, 140, 168]), np.array([228.0, 222, 204])
_MAX_POINTS = 400_000
_BREAK_M = 35.0  # poses farther apart are not connected
_MARKER_M = 0.4  # points larger than this are markers
_ABOVE_M = 3.0  # height of markers above the trajectory


class MapScene:
    """Draw a map and queries, relative to the map's origin.

    Parameters
    ----------
    api : viser.SceneApi
    prior_map : SegmentMap
    """

    def __init__(self, api: Any, prior_map: SegmentMap) -> None:
        self._api, self._map = api, prior_map
        self.layers: dict[str, list[Any]] = {name: [] for name in (*FIXED, "robot", *OF_QUERY)}
        self._hidden: set[str] = set()

    def show(self, layer: str, visible: bool) -> None:
        """Show or hide a layer permanently."""
        (self._hidden.discard if visible else self._hidden.add)(layer)
        for handle in self.layers[layer]:
            handle.visible = visible

    def clear(self, layer: str) -> None:
        """Remove a layer's contents."""
        for handle in self.layers[layer]:
            handle.remove()
        self.layers[layer] = []

    def local(self, points: Any) -> Float32:
        """Convert points from the map's frame to the scene's."""
        return np.asarray(points - self._map.origin, dtype=np.float32)

    def draw_map(self) -> None:
        """Draw the cloud by height, the segments' centroids, and the trajectory."""
        cloud = self._map.cloud[:: 1 + len(self._map.cloud) // _MAX_POINTS]
        if len(cloud):
            self.points("map", "/map/cloud", cloud, _by_height(cloud), 0.12)
        path = (self._map.trajectory[:, :3, 3] - self._map.origin).astype(np.float32)
        pairs = np.stack([path[:-1], path[1:]], axis=1)
        near = np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1) < _BREAK_M
        self.lines("path", "/map/path", pairs[near], BLUE, 0.25)

    def draw_queries(self, queries: Sequence[Shown]) -> None:
        """Draw a marker per query by outcome; rejected ones at the best pose, if stored."""
        for outcome, colour in COLOURS.items():
            places = [
                place
                for query in queries
                if query.outcome == outcome and (place := self._place(query)) is not None
            ]
            if places:
                points = np.array(places, dtype=np.float32) + np.array([0, 0, _ABOVE_M], np.float32)
                self.points("queries", f"/queries/{outcome}", points, _all(colour, points), 1.2)

    def _place(self, query: Shown) -> Float64 | None:
        T = query.T_map_sensor
        if T is None and query.stages is not None:
            T = query.stages.T_map_local
        return None if T is None else np.asarray(T[:3, 3] - self._map.origin)

    def middle(self, query: Shown | None) -> Float64:
        """Return the point to look at: a query, or the middle of the map."""
        place = None if query is None else self._place(query)
        if place is not None:
            return place
        cloud = self._map.cloud
        return np.median(cloud, axis=0).astype(np.float64) if len(cloud) else np.zeros(3)

    def draw_query(self, query: Shown) -> None:
        """Draw one query: cloud, segments, matches, runner-up, and outcome."""
        for layer in OF_QUERY:
            self.clear(layer)
        at = self.middle(query) + [0.0, 0.0, 3.0 * _ABOVE_M]
        text = f"{query.index}: {query.outcome}"  # the panel has the rest
        label = self._api.add_label("/query/label", text, position=tuple(at))
        self._keep("text", label)
        if query.stages is not None and query.stages.T_map_local is not None:
            self._draw_stages(query.stages)

    def _draw_stages(self, stages: Stages) -> None:
        T = stages.T_map_local
        assert T is not None

        def placed(points: Float32) -> Float32:
            return (geometry.transform(T, points) - self._map.origin).astype(np.float32)

        for name, chosen, colour in (("off", ~stages.on_map, RED), ("on", stages.on_map, GREEN)):
            points = placed(stages.points[chosen])
            self.points("cloud", f"/query/{name}_map", points, _all(colour, points), 0.18)
        lifted = placed(stages.segment_points)
        self.points("segments", "/query/segments", lifted, _distinct(stages.segment_of), 0.26)
        known = stages.matched < len(self._map.centroids)
        there = (self._map.centroids[stages.matched[known]] - self._map.origin).astype(np.float32)
        lines = np.stack([placed(stages.centroids[known]), there], axis=1)
        fits = stages.inliers[known]
        self.lines("other matches", "/query/other_matches", lines[~fits], PATH, 0.04)
        lines = lines.copy()
        lines[:, 0, 2] += 6.0  # nearly upright, so that inliers stand out
        self.lines("matches that agree", "/query/inliers", lines[fits], GREEN, 0.3)
        if stages.T_map_other is not None:
            other = (stages.T_map_other[:3, 3] - self._map.origin).astype(np.float32)[None]
            self.points("runner-up", "/query/runner_up", other, _all(RED, other), 1.5)
            name = "/query/runner_up_label"
            self._keep("runner-up", self._api.add_label(name, "runner-up", position=other[0]))

    def points(self, layer: str, name: str, points: Float32, colors: Colors, size: float) -> None:
        """Add points (N, 3) in the scene's frame to a layer."""
        if len(points):
            # In random order, so that any part is a thinned cloud. Half floats would be half a
            # metre off at a distance of one kilometre.
            mixed = np.random.default_rng(0).permutation(len(points))
            style: dict[str, Any] = {
                "point_size": size,
                "point_shading": "flat",
                "precision": "float32",
            }
            if size > _MARKER_M:
                style["point_shape"] = "circle"
            handle = self._api.add_point_cloud(name, points[mixed], colors[mixed], **style)
            self._keep(layer, handle)

    def lines(self, layer: str, name: str, lines: Float32, colour: str, width: float) -> None:
        """Add lines (N, 2, 3) in the scene's frame to a layer."""
        if len(lines):
            colors = np.tile(np.array(rgb(colour), np.uint8), (len(lines), 2, 1))
            handle = self._api.add_line_segments(name, lines, colors, thickness=width)
            self._keep(layer, handle)

    def _keep(self, layer: str, handle: Any) -> None:
        handle.visible = layer not in self._hidden
        self.layers[layer].append(handle)


def _all(colour: str, points: Float32) -> Colors:
    """Return one colour for all points."""
    return np.tile(np.array(rgb(colour), np.uint8), (len(points), 1))


def _by_height(points: Float32) -> Colors:
    low, high = np.percentile(points[:, 2], [2, 98])
    share = ((points[:, 2] - low) / max(high - low, 1e-6)).clip(0.0, 1.0)[:, None]
    return np.asarray(_LOW + share * (_HIGH - _LOW), dtype=np.uint8)


def _distinct(owners: NDArray[np.int64]) -> Colors:
    """Return a colour per segment, distinct for neighbours."""
    count = int(owners.max()) + 1 if len(owners) else 0
    wheel = [colorsys.hsv_to_rgb(hue(k), 0.75, 0.9) for k in range(count)]
    return (255 * np.array(wheel).reshape(-1, 3)).astype(np.uint8)[owners]
