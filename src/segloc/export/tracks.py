"""Trajectories as TUM files and as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError, SeglocError
from ..io import Trajectory, write_tum
from ..map.georeference import Georeference
from ..system.files import write_text
from ..types import Float64
from .sources import AlignedSource, FoundSource, MapSource, Source

BREAK_M = 35.0
"""Poses farther apart are not connected by a line."""
UNTIMED = "no times: the first column is the scan number"
_EQUATOR_M, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # WGS 84


@dataclass(frozen=True)
class Place:
    """Place of a map's origin on the globe; its x axis points east."""

    latitude: float  # degrees, WGS 84
    longitude: float

    @classmethod
    def parse(cls, text: str) -> Place:
        """Parse ``LATITUDE,LONGITUDE``; raise ConfigError if the text is invalid."""
        try:
            latitude, longitude = (float(part) for part in text.split(","))
        except ValueError as error:
            raise ConfigError(
                f"--at {text[:40]!r}: expects LATITUDE,LONGITUDE in degrees"
            ) from error
        if not (abs(latitude) < 89.9 and abs(longitude) <= 180.0):
            raise ConfigError(f"--at {text[:40]!r}: outside the globe, or at a pole")
        return cls(latitude, longitude)

    def degrees(self, xy: Float64) -> Float64:
        """Convert (N, 2) metres to longitude, latitude; accurate to 1 cm within some kilometres."""
        phi = math.radians(self.latitude)
        squared = _FLATTENING * (2.0 - _FLATTENING)
        bent = 1.0 - squared * math.sin(phi) ** 2
        north = _EQUATOR_M * (1.0 - squared) / bent**1.5
        east = _EQUATOR_M / math.sqrt(bent) * math.cos(phi)
        steps = np.degrees(xy / np.array([east, north]))
        return np.asarray(steps + [self.longitude, self.latitude], dtype=np.float64)


def tracks(source: Source) -> Iterator[tuple[str, Trajectory, str]]:
    """Yield name, trajectory, and a remark on its stamps, of each session."""
    if isinstance(source, MapSource):
        poses = source.prior_map.trajectory
        if not len(poses):
            raise SeglocError(f"{source.path}: the map has no sensor trajectory")
        numbers = np.arange(len(poses), dtype=np.float64)
        yield source.path.stem, Trajectory(numbers, poses), "a map's poses have no times: numbered"
    elif isinstance(source, FoundSource):
        if not len(source.track):
            raise SeglocError(f"{source.path}: no trajectory: no query was localized")
        yield source.path.resolve().name, source.track, "" if source.timed else UNTIMED
    else:
        for k, name in enumerate(source.names):
            yield name, source.session(k), UNTIMED


def write_tum_files(source: Source, out: Path) -> list[str]:
    """Write one file; for several aligned sessions a folder with one file each."""
    listed = list(tracks(source))
    if not isinstance(source, AlignedSource) or len(listed) == 1:
        write_tum(out, *listed[0][1:])
        return []
    out.mkdir(parents=True, exist_ok=True)
    for k, (_, track, remark) in enumerate(listed):
        write_tum(out / f"session_{k}.tum", track, remark)
    return []


def write_geojson(
    source: Source, out: Path, epsg: int | None = None, place: Place | None = None
) -> list[str]:
    """Write one feature per session, in degrees if possible, else in map coordinates.

    RFC 7946 requires WGS 84. Coordinates are in degrees if the map is georeferenced, or by
    ``place``. Otherwise they are the map's metres, and ``epsg`` names their frame in the member
    "crs" of GeoJSON 2008, which GDAL and QGIS support.
    """
    if epsg is not None and place is not None:
        raise ConfigError("--epsg and --at exclude each other")
    globe = _georeference(source) if epsg is None and place is None else None
    features = [_feature(name, track.poses, place or globe) for name, track, _ in tracks(source)]
    document: dict[str, Any] = {"type": "FeatureCollection"}
    if epsg is not None:
        name = f"urn:ogc:def:crs:EPSG::{epsg}"
        document["crs"] = {"type": "name", "properties": {"name": name}}
    document["features"] = features
    write_text(out, json.dumps(document, allow_nan=False) + "\n")
    if epsg is None and place is None and globe is None:
        return ["coordinates are the map's metres: --at LAT,LON or --epsg N georeferences them"]
    return []


def _georeference(source: Source) -> Georeference | None:
    """Return the georeference of a map or of the map of results."""
    if isinstance(source, MapSource):
        return Georeference.of(source.prior_map.metadata)
    return source.georeference if isinstance(source, FoundSource) else None


def _feature(name: str, poses: Float64, place: Place | Georeference | None) -> dict[str, Any]:
    xyz = poses[:, :3, 3]
    if isinstance(place, Georeference):
        xyz = place.on_globe(xyz)
    elif place is not None:
        xyz = np.column_stack([place.degrees(xyz[:, :2]), xyz[:, 2]])
    steps = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
    digits = 3 if place is None else 8
    lines = [
        [[round(float(x), digits), round(float(y), digits), round(float(z), 3)] for x, y, z in part]
        for part in np.split(xyz, np.flatnonzero(steps > BREAK_M) + 1)
    ]
    lines = [line if len(line) > 1 else line * 2 for line in lines]  # a line needs two points
    geometry = {"type": "MultiLineString", "coordinates": lines}
    properties = {"name": name, "poses": len(poses)}
    return {"type": "Feature", "properties": properties, "geometry": geometry}
