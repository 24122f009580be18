"""The whole configuration: the sections of all stages, and a preset per method."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, Field

from . import descriptors
from .errors import ConfigError, MapMismatch
from .likelihood import VerificationConfig, shipped_model
from .map.config import (
    DEFAULT_METHOD,
    NARROW_SEGMENTATION,
    BuildConfig,
    stored_config,
    without_mount,
)
from .map.info import plan_tolerance_m
from .map.segment_map import SegmentMap
from .proposals.first_sight import FirstSightConfig
from .proposals.matching import MatchingConfig
from .proposals.occupancy import OccupancyConfig
from .proposals.pose import PoseConfig
from .system.section import Section, read_yaml

Model = TypeVar("Model", bound=Section)

FOR_USERS = (
    "method",
    "weights",
    "threads",
    "seed",
    "local_cloud.radius_m",
    "local_cloud.window_m",
    "local_cloud.max_gap_m",
    "local_cloud.attitude.estimate",
    "local_cloud.mount.xyz_m",
    "local_cloud.mount.rpy_deg",
    "local_cloud.mount.matrix",
    "local_cloud.mount.poses_of_base",
    "local_cloud.body",
    "mapping.views",
    "mapping.level",
    "first_sight.enabled",
    "matching.neighbours",
    "matching.escalation",
    "pose.estimator",
    "occupancy.enabled",
    "proposers",
    "verification.min_confidence",
    "verification.refine",
)
"""Settings for users. The model of the posterior was fitted under the others."""

_UNITS = {"_m": "metres", "_deg": "degrees", "_ms": "milliseconds", "_s": "seconds"}
"""Units of keys, by the end of their names."""


class Config(BuildConfig):
    """All settings. Frozen: derive a changed one by ``model_copy(update=...)``."""

    first_sight: FirstSightConfig = FirstSightConfig()
    matching: MatchingConfig = MatchingConfig()
    pose: PoseConfig = PoseConfig()
    occupancy: OccupancyConfig = OccupancyConfig()
    proposers: tuple[str, ...] = Field(
        (), description="proposers of plug-ins, used before occupancy if segments are inconclusive"
    )
    verification: VerificationConfig = VerificationConfig()

    @classmethod
    def preset(cls, method: str) -> Config:
        """Return the configuration of a method.

        Raises
        ------
        ConfigError
            If there is no such method.
        """
        return cls.model_validate({"method": method, **descriptors.preset(method)})

    @classmethod
    def load(cls, path: str | Path | None, method: str | None = None) -> Config:
        """Read a YAML file; missing keys come from the preset of its method.

        Raises
        ------
        ConfigError
            If the file is no YAML mapping, a key or value is wrong, or the file asks for another
            method than the caller; names file and key.
        """
        values = {} if path is None else read_yaml(Path(path))
        preset = cls.preset(method or str(values.get("method", DEFAULT_METHOD)))
        if values.get("method", preset.method) != preset.method:
            raise ConfigError(f"{path}: method: {values['method']!r}, where {method!r} is needed")
        merged = _merge(preset.model_dump(), {**values, "method": preset.method})
        return validate(cls, merged, str(path))

    def explained(self, every: bool = False) -> str:
        """Format as YAML with the meaning of each key: those of :data:`FOR_USERS`, or all."""
        return "\n".join(_explain(self, "", "", every)) + "\n"


def map_config(prior_map: SegmentMap) -> Config:
    """Return the configuration of a map, except threads and the sensor's mount."""
    return stored_config(prior_map, Config)


def query_config(prior_map: SegmentMap, config: Config | None) -> tuple[Config, tuple[str, ...]]:
    """Return the configuration of queries in a map, and notes on it.

    Returns
    -------
    Config
        The given one; by default that of the map.
    tuple of str
        Settings that differ from those of the map, and from those of the fit of the confidence.

    Raises
    ------
    MapMismatch
        If the configuration is of another method than the map.
    """
    if config is not None and config.method != prior_map.descriptor:
        raise MapMismatch(
            f"the map has descriptors of {prior_map.descriptor!r}, "
            f"but the configuration is of method {config.method!r}"
        )
    built = map_config(prior_map)
    config = config or built
    notes = []
    if plan_tolerance_m(prior_map.metadata) is not None:
        notes.append(
            "the map was made from a plan (experimental), so single scans find less: accumulate "
            "scans, or pass a prior"
        )
    if changed := differences(_shared_settings(config), _shared_settings(built)):
        notes.append(f"not as the map was built: {', '.join(changed)}")
    fitted = _merge(dict(shipped_model().settings), dict(descriptors.preset(config.method)))
    values = config.model_dump(mode="json")
    if config.segmentation == NARROW_SEGMENTATION:  # chosen for the sensor, not by the user
        del values["segmentation"]
    if changed := differences(values, fitted):
        notes.append(f"confidence was fitted under other values of {', '.join(changed)}")
    return config, tuple(notes)


def differences(values: Mapping[str, Any], others: Mapping[str, Any]) -> list[str]:
    """Return common keys of nested mappings, joined by dots, with different values."""
    found = []
    for key in sorted(values.keys() & others.keys()):
        mine, theirs = values[key], others[key]
        if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
            found += [f"{key}.{inner}" for inner in differences(mine, theirs)]
        elif _plain(mine) != _plain(theirs):
            found.append(key)
    return found


def _plain(value: Any) -> Any:
    return [_plain(each) for each in value] if isinstance(value, (list, tuple)) else value


def _shared_settings(config: Config) -> dict[str, Any]:
    """Return the settings that should be equal for maps and queries."""
    chosen = {"local_cloud", "segmentation"}
    return without_mount(config).model_dump(mode="json", include=chosen)


def _explain(model: BaseModel, prefix: str, indent: str, every: bool) -> Iterator[str]:
    for name, info in type(model).model_fields.items():
        value, key = getattr(model, name), f"{prefix}{name}"
        if isinstance(value, BaseModel):
            lines = list(_explain(value, f"{key}.", f"{indent}  ", every))
            if lines:
                yield f"{indent}{name}:"
                yield from lines
        elif every or key in FOR_USERS:
            plain = model.model_dump(mode="json")[name]
            text = yaml.safe_dump(plain, default_flow_style=True, width=1000).split("\n...")[0]
            yield f"{indent}{name}: {text.strip()}{_comment(name, info.description)}"


def _comment(name: str, text: str | None) -> str:
    """Return the meaning of a key, with the unit in its name."""
    if not text:
        return ""
    unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")
    has_unit = any(re.search(rf"\b{word}s?\b", text) for word in ("metre", "degree"))
    return f"  # {text}" if has_unit or not unit else f"  # {text}, {unit}"


def validate(model: type[Model], values: Mapping[str, Any], where: str) -> Model:
    """Validate the values of a section of configuration from ``where``.

    Raises
    ------
    ConfigError
        If a key is unknown or a value out of range; names ``where`` and the key.
    """
    try:
        return model.model_validate(values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error


def _merge(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        both = isinstance(old, dict) and isinstance(value, dict)
        merged[key] = _merge(old, value) if both else value  # type: ignore[arg-type]
    return merged
