"""Draw a map, queries and one query in detail as a scene of viser."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ... import geometry
from ...map.georeference import Georeference
from ...map.segment_map import SegmentMap
from ...types import Float32, Float64, Pose
from .pictures import (
    GREEN,
    HEIGHTS,
    MAGENTA,
    ORANGE,
    PALETTE,
    PATH,
    RED,
    VIOLET,
    by_height,
    hue,
    rgb,
    round_length,
)
from .results import Outcome, Shown, Stages

Colors = NDArray[np.uint8]

COLOURS: dict[Outcome, str] = {"localized": GREEN, "refused": ORANGE, "false": RED}
FIXED = ("map", "trajectory", "queries", "scale")
ROBOT = ("map", "trajectory", "robot", "scale")
OTHER, RUNNER_UP = "other matches", "runner-up"
"""Layers hidden at first."""
OF_QUERY = ("sensor", "cloud", "segments", "matches that agree", OTHER, RUNNER_UP)
"""Layers that can be hidden: of the map, of a map with a robot, of the selected query."""
_MAX_POINTS = 400_000
_EYE_M = 0.5  # size of a viewpoint
_ARROW_M, _CHOSEN_M = 3.0, 12.0  # lengths of the arrows of sensors
_ABOVE_M = 6.0  # inliers are drawn from this height, nearly upright, so that they stand out
_BACK, _UP, _IN_VIEW_M = 0.47, 0.63, 95.0  # the camera, in widths of what is in view; least width


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
        self._hidden = {OTHER, RUNNER_UP}

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

    def draw_map(self) -> list[tuple[str, str]]:
        """Draw the cloud, where it was driven, and viewpoints; return the legend.

        The cloud is coloured by height; by the session of the nearest segment if there are several.
        """
        cloud = self._map.cloud[:: 1 + len(self._map.cloud) // _MAX_POINTS]
        legend = self._draw_trajectory()
        sessions, session = np.unique(self._map.session, return_inverse=True)
        if not len(cloud):
            return legend
        if len(sessions) < 2:
            self.points("map", "/map/cloud", cloud, by_height(cloud[:, 2]), 0.12)
            low, high = np.percentile(cloud[:, 2] + self._map.origin[2], [2, 98])
            heights = (HEIGHTS[0], f"map at {low:.0f} m"), (HEIGHTS[-1], f"at {high:.0f} m")
            return [*heights, *legend]
        nearest = cKDTree(self.local(self._map.centroids)).query(cloud)[1]
        colours = [PALETTE[k % len(PALETTE)] for k in range(len(sessions))]
        table = np.array([rgb(colour) for colour in colours], np.uint8)
        self.points("map", "/map/cloud", cloud, table[session[nearest]], 0.12)
        named = ((colour, f"session {k}") for colour, k in zip(colours, sessions, strict=True))
        return [*named, *legend]

    def _draw_trajectory(self) -> list[tuple[str, str]]:
        """Draw drives as lines, and viewpoints chosen in a cloud or plan as points."""
        path, driven = self.local(self._map.trajectory[:, :3, 3]), self._map.is_driven
        pairs = np.stack([path[:-1], path[1:]], axis=1)
        near = np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1) < geometry.PATH_BREAK_M
        near &= driven[:-1] & driven[1:]
        self.lines("trajectory", "/map/trajectory", pairs[near], MAGENTA, 0.3)
        chosen = path[~driven]
        self.points("trajectory", "/map/viewpoints", chosen, _all(MAGENTA, chosen), _EYE_M)
        kinds = (driven.any(), "mapped trajectory"), (not driven.all(), "viewpoints of the map")
        return [(MAGENTA, name) for exists, name in kinds if exists]

    def draw_queries(self, queries: Sequence[Shown]) -> None:
        """Draw an arrow per query by outcome; rejected ones at the best pose, if stored."""
        for outcome, colour in COLOURS.items():
            poses = [T for q in queries if q.outcome == outcome and (T := q.T_map_best) is not None]
            self.arrows("queries", f"/queries/{outcome}", poses, colour, _ARROW_M)

    def middle(self, query: Shown | None = None) -> Float64:
        """Return the point to look at: a query, or the middle of the map."""
        T = None if query is None else query.T_map_best
        if T is not None:
            return np.asarray(T[:3, 3] - self._map.origin)
        cloud = self._map.cloud
        return np.median(cloud, axis=0).astype(np.float64) if len(cloud) else np.zeros(3)

    def in_view(self, *places: Float32 | Float64) -> tuple[Float64, Float64]:
        """Draw the scale for a view of places, or of the middle of the map; return the camera.

        Returns
        -------
        position, target : (3,) float64
        """
        places = places or (self.middle(),)
        low, high = np.min(places, axis=0), np.max(places, axis=0).astype(np.float64)
        middle, width = (low + high) / 2, max(_IN_VIEW_M, float(np.linalg.norm((high - low)[:2])))
        self._draw_scale(middle, width)
        return middle + width * np.array([0.0, -_BACK, _UP]), middle

    def _draw_scale(self, middle: Float64, width_m: float) -> None:
        """Draw a scale bar and north, or else the y axis of the map, at the lower left."""
        self.clear("scale")
        length = round_length(width_m / 4)
        corner = middle + width_m * np.array([-0.3, -0.22, 0.0])
        along, north = corner + [length, 0.0, 0.0], corner + [0.0, length / 2, 0.0]
        bar = np.array([[corner, along]], dtype=np.float32)
        self.lines("scale", "/scale/bar", bar, PATH, 0.006 * width_m)
        T = geometry.yaw_transform(np.pi / 2, tuple(corner + self._map.origin))
        self.arrows("scale", "/scale/arrow", [T], PATH, length / 2)
        georeferenced = Georeference.of(self._map.metadata) is not None
        self.label("scale", "/scale/length", f"{length} m", along, "center-left")
        self.label("scale", "/scale/up", "north" if georeferenced else "y", north, "bottom-center")

    def draw_query(self, query: Shown) -> None:
        """Draw one query: sensor, cloud, segments, matches and runner-up."""
        for layer in OF_QUERY:
            self.clear(layer)
        T, colour = query.T_map_best, COLOURS[query.outcome]
        if T is None:
            return
        self.arrows("sensor", "/query/sensor", [T], colour, _CHOSEN_M)
        at = self.middle(query) + [0.0, 0.0, 2 * _ABOVE_M]  # clear of the arrow
        name = f"{query.index}: {query.outcome}"  # the panel has the rest
        self.label("sensor", "/query/label", name, at, "bottom-center")
        if query.stages is not None and query.stages.T_map_local is not None:
            self._draw_stages(query.stages, query.stages.T_map_local)

    def _draw_stages(self, stages: Stages, T: Pose) -> None:
        def place(points: Float32) -> Float32:
            return self.local(geometry.transform(T, points))

        for name, chosen, colour in (("off", ~stages.on_map, RED), ("on", stages.on_map, GREEN)):
            points = place(stages.points[chosen])
            self.points("cloud", f"/query/{name}_map", points, _all(colour, points), 0.18)
        lifted = place(stages.segment_points)
        self.points("segments", "/query/segments", lifted, _distinct(stages.segment_of), 0.26)
        known = stages.matched < len(self._map.centroids)
        there = self.local(self._map.centroids[stages.matched[known]])
        lines = np.stack([place(stages.centroids[known]), there], axis=1)
        fits = stages.inliers[known]
        self.lines(OTHER, "/query/other_matches", lines[~fits], PATH, 0.04)
        lines = lines.copy()
        lines[:, 0, 2] += _ABOVE_M
        self.lines("matches that agree", "/query/inliers", lines[fits], GREEN, 0.3)
        if stages.T_map_other is not None:
            self._draw_runner_up(stages, T @ stages.T_local_sensor, stages.T_map_other)

    def _draw_runner_up(self, stages: Stages, T_map_sensor: Pose, T_map_other: Pose) -> None:
        T = T_map_other @ geometry.inverse(stages.T_local_sensor)
        points = self.local(geometry.transform(T, stages.points))
        self.points(RUNNER_UP, "/runner_up/cloud", points, _all(VIOLET, points), 0.18)
        self.arrows(RUNNER_UP, "/runner_up/sensor", [T_map_other], VIOLET, _CHOSEN_M)
        away = np.linalg.norm(T_map_other[:3, 3] - T_map_sensor[:3, 3])
        at = T_map_other[:3, 3] - self._map.origin
        name = f"{RUNNER_UP}, {away:.1f} m away"
        self.label(RUNNER_UP, "/runner_up/label", name, at, "top-center")

    def points(self, layer: str, name: str, points: Float32, colors: Colors, size: float) -> None:
        """Add points (N, 3) in the scene's frame to a layer."""
        if len(points):
            # In random order, so that any part is a thinned cloud. Half floats would be half a
            # metre off at a distance of one kilometre.
            mixed = np.random.default_rng(0).permutation(len(points))
            style = {"point_size": size, "point_shading": "flat", "precision": "float32"}
            handle = self._api.add_point_cloud(name, points[mixed], colors[mixed], **style)
            self._keep(layer, handle)

    def lines(
        self, layer: str, name: str, lines: Float32, colour: str | Colors, width: float
    ) -> None:
        """Add lines (N, 2, 3) in the scene's frame to a layer, in one colour or one per line."""
        if len(lines):
            each = _all(colour, lines) if isinstance(colour, str) else colour
            colors = np.repeat(_linear(each)[:, None], 2, axis=1)
            handle = self._api.add_line_segments(name, lines, colors, thickness=width)
            self._keep(layer, handle)

    def arrows(
        self, layer: str, name: str, poses: Sequence[Pose], colour: str, length_m: float
    ) -> None:
        """Add an arrow along the x axis of each pose in the map's frame to a layer."""
        if not poses:
            return
        T = np.array(poses)
        start = T[:, :3, 3] + [0.0, 0.0, 0.2 * length_m]
        ends = np.stack([start, start + length_m * T[:, :3, 0]], axis=1)
        radii = {"shaft_radius": 0.07 * length_m, "head_radius": 0.2 * length_m}
        handle = self._api.add_arrows(
            name, self.local(ends), _linear(rgb(colour)), head_length=0.45 * length_m, **radii
        )
        self._keep(layer, handle)

    def label(self, layer: str, name: str, text: str, at: Float64, anchor: str) -> None:
        """Add a label at a point in the scene's frame to a layer."""
        self._keep(layer, self._api.add_label(name, text, position=tuple(at), anchor=anchor))

    def _keep(self, layer: str, handle: Any) -> None:
        handle.visible = layer not in self._hidden
        self.layers[layer].append(handle)


def _all(colour: str, items: Float32) -> Colors:
    """Return one colour for all items."""
    return np.tile(np.array(rgb(colour), np.uint8), (len(items), 1))


def _linear(colors: Any) -> Colors:
    """Return colours as viser takes them for lines and arrows: of linear intensity."""
    return (255 * (np.asarray(colors) / 255) ** 2.2).astype(np.uint8)


def _distinct(owners: NDArray[np.int64]) -> Colors:
    """Return a colour per segment, distinct for neighbours."""
    count = int(owners.max()) + 1 if len(owners) else 0
    wheel = [colorsys.hsv_to_rgb(hue(k), 0.75, 0.9) for k in range(count)]
    return (255 * np.array(wheel).reshape(-1, 3)).astype(np.uint8)[owners]
