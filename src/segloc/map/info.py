"""Facts about a map, as JSON values and as a table."""

from __future__ import annotations

from typing import Any

from ..system.text import counted
from .georeference import Georeference

SOURCE, CLOUD = "source", "cloud"
"""Key of the metadata, and its value for maps of one finished cloud."""
_MAX_TEXT = 200


class MapInfo(dict[str, Any]):
    """Facts by name, as JSON values; printed as a table."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the facts in words, with units."""
        metadata = self["metadata"]
        extent = " x ".join(f"{metres:.0f}" for metres in self["extent_m"])
        rows = [
            ("descriptor", f"{self['descriptor']}, {self['dim']} numbers ({self['fingerprint']})"),
            ("segments", f"{self['segments']}"),
            ("poses", f"{self['poses']} in {counted(self['sessions'], 'sessions')}"),
            ("cloud", f"{self['cloud_points']} points, one per {self['cloud_voxel_m']:g} m"),
            ("extent", f"{extent} m"),
            ("in memory", f"{self['memory_bytes'] / 1e6:.1f} MB"),
        ]
        if CLOUD in metadata.get(SOURCE, ""):
            spacing = metadata.get("cloud_spacing_m", "unknown")
            rows.append(("made from", f"a cloud, points {spacing[:_MAX_TEXT]} m apart"))
        if frame := metadata.get("frame"):
            rows.append(("frame", frame[:_MAX_TEXT]))
        if (where := Georeference.of(metadata)) is not None:
            rows.append(("georeference", str(where)))
        return rows

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in rows)
