"""Facts about a map, as JSON values and as a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..system.text import quantity
from .georeference import Georeference

TEXT_SEPARATOR = "\n---\n"
"""Separates the texts of merged maps."""
SOURCE, CLOUD, PLAN = "source", "cloud", "plan"
"""Key of the metadata, and its values for maps of one finished cloud, and of a building's plan."""
TOLERANCE = "tolerance_m"
"""Key of the metadata: how far a building may be off its plan [m]."""
MAX_TOLERANCE_M = 0.5
THICKNESS, SHARP_M = "thickness_m", 0.08
"""Key of the metadata: how thick the walls of a finished cloud are [m], and how thick those of maps
of recordings are at most."""
CLOUD_FRAME = "T_map_cloud"
"""Key of the metadata: transform from the frame of a finished cloud that was levelled."""
VIEWPOINTS, LATTICE, BETWEEN = "viewpoints", "lattice", "between"
"""Key of the metadata, and its values for a cloud without ground: viewpoints on a lattice, as 0.3.0
chose them, about which no free space is known, and viewpoints between what stands."""
GROUND, NO_GROUND = "ground", "none"
"""Key of the metadata, and its value for a cloud without ground."""
_WITHOUT_GROUND = {
    LATTICE: "on a lattice, since there is no ground",
    BETWEEN: "between what stands, since there is no ground",
}
_GROUND = "on free ground"
_MAX_TEXT = 200


def plan_tolerance_m(metadata: Mapping[str, str]) -> float | None:
    """Return how far a building may be off the plan its map is of; None if it is of no plan.

    It is 0 if it cannot be read, and the largest one of merged maps.
    """
    return _metres(metadata, TOLERANCE) if PLAN in metadata.get(SOURCE, "") else None


def tolerance_m(metadata: Mapping[str, str]) -> float:
    """Return how much farther off the map's walls a scan may be than in the map of a recording [m].

    As a building may be off its plan, or as the walls of a finished cloud are thicker.
    """
    tolerance = plan_tolerance_m(metadata)
    if tolerance is None:
        tolerance = max(_metres(metadata, THICKNESS) - SHARP_M, 0.0)
    return tolerance


def _metres(metadata: Mapping[str, str], key: str) -> float:
    try:  # of merged maps the largest
        metres = max(map(float, metadata.get(key, "").split(TEXT_SEPARATOR)))
    except ValueError:
        return 0.0
    return metres if 0 < metres <= MAX_TOLERANCE_M else 0.0


class MapInfo(dict[str, Any]):
    """Facts by name, as JSON values; printed as a table."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the facts in words, with units."""
        metadata = self["metadata"]
        extent = " x ".join(f"{metres:.0f}" for metres in self["extent_m"])
        rows = [
            ("descriptor", f"{self['descriptor']}, {self['dim']} numbers ({self['fingerprint']})"),
            *self._contents_rows(),
            ("extent", f"{extent} m"),
        ]
        if CLOUD in metadata.get(SOURCE, ""):
            spacing = metadata.get("cloud_spacing_m", "unknown")
            text = f"a cloud, points {spacing[:_MAX_TEXT]} m apart"
            if thickness := _metres(metadata, THICKNESS):
                text += f", walls {thickness:g} m thick"
            rows.append(("made from", text))
        if (off := plan_tolerance_m(metadata)) is not None:
            rows.append(("made from", f"a plan, as built within {off:g} m (experimental)"))
        if frame := metadata.get("frame"):
            rows.append(("frame", frame[:_MAX_TEXT]))
        if (where := Georeference.of(metadata)) is not None:
            rows.append(("georeference", str(where)))
        return rows

    def _contents_rows(self) -> list[tuple[str, str]]:
        """Return rows of tiles, or of segments and cloud, and of the poses."""
        if "tiles" in self:
            tiles = f"{self['tiles']} of {self['tile_m']:g} m"
            return [("tiles", tiles), *self._poses_rows()]
        cloud = f"{self['cloud_points']} points, one per {self['cloud_voxel_m']:g} m"
        return [("segments", f"{self['segments']}"), *self._poses_rows(), ("cloud", cloud)]

    def _poses_rows(self) -> list[tuple[str, str]]:
        """Return rows of the poses that a sensor had, and of viewpoints chosen in a cloud."""
        chosen = self["viewpoints"]
        driven, sessions = self["poses"] - chosen, quantity(self["sessions"], "sessions")
        rows = [("poses", f"{driven} in {sessions}")] if driven or not chosen else []
        if chosen:
            kind = self["metadata"].get(VIEWPOINTS, "")
            where = next((text for key, text in _WITHOUT_GROUND.items() if key in kind), _GROUND)
            rows.append(("viewpoints", f"{chosen} {where}"))
        return rows

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in rows)
