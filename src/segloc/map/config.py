"""Configuration of map building."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, Field

from ..descriptors import preset
from ..errors import ConfigError
from ..frontend.local_cloud import LocalCloudConfig
from ..frontend.mounting import MountConfig
from ..frontend.segmentation import ClusterConfig, SegmentationConfig
from ..system.section import Section, parse_yaml
from .compact import CompactConfig
from .info import TEXT_SEPARATOR
from .segment_map import SegmentMap

DEFAULT_METHOD = "profile"
_MAX_CHARACTERS = 1 << 16  # of the configuration in a map file, which has about 3000

SMALL_CLOUD_VOXEL_M = 0.4
"""Voxel of the cloud of a small map [m]."""


class ViewConfig(Section):
    """One length of the local clouds of a map."""

    length_m: float = Field(
        ge=0, le=10_000, description="travelled distance a view spans; 0: single scans"
    )
    every_m: float = Field(ge=0.05, le=10_000, description="distance between views")


class MappingConfig(Section):
    """Views of a map: several lengths, since short ones match single scans best."""

    views: tuple[ViewConfig, ...] = Field(
        (
            ViewConfig(length_m=40, every_m=8),
            ViewConfig(length_m=16, every_m=8),
        ),
        description="local clouds that segments are cut from, metres",
    )
    cloud_voxel: float = Field(
        0.3, ge=0.01, le=10, description="voxel of the cloud kept for verification, metres"
    )
    level: bool = Field(
        False, description="turn the poses about the first so that z is up, by walls in the scans"
    )
    compact: CompactConfig = CompactConfig()

    def smallest(self) -> MappingConfig:
        """Return the settings for the smallest map."""
        compact = CompactConfig(bits=4, max_views=1, cloud_bits=0, cloud_range_m=30.0)
        return self.model_copy(update={"compact": compact, "cloud_voxel": SMALL_CLOUD_VOXEL_M})


class BuildConfig(Section):
    """Configuration of a map; :class:`segloc.Config` adds the settings of queries.

    Frozen: derive a changed one with ``model_copy(update=...)``.
    """

    method: str = Field(DEFAULT_METHOD, description="name of the descriptor")
    weights: Path | None = Field(
        None, description="file of trained weights instead of the shipped ones"
    )
    threads: int = Field(0, ge=0, le=1024, description="number of threads; 0: all cores")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="random seed of prosac and ransac")
    local_cloud: LocalCloudConfig = LocalCloudConfig()
    segmentation: SegmentationConfig = SegmentationConfig()
    mapping: MappingConfig = MappingConfig()

    def to_yaml(self) -> str:
        """Return the whole configuration as YAML, including defaults."""
        values = self.model_dump(mode="json")
        if self.local_cloud.body is None:
            del values["local_cloud"]["body"]  # version 0.3.0 takes no configuration with it
        text: str = yaml.safe_dump(values, sort_keys=False)
        return text


NARROW_VIEWS = tuple(ViewConfig(length_m=length, every_m=2.0) for length in (40, 16, 4))
NARROW_SEGMENTATION = SegmentationConfig(
    accumulated=ClusterConfig(voxel_size=0.1, tolerance=0.2, min_points=30),
    single=ClusterConfig(voxel_size=0.1, tolerance=0.3, min_points=10),
)
"""A narrow view holds few separate objects and changes quickly as the sensor turns, so segments are
finer and views closer together."""


def checked_build_config(config: BuildConfig | None) -> BuildConfig:
    """Return the given configuration, or that of the default method.

    Raises
    ------
    ConfigError
        If it is of another type.
    """
    if config is None:
        return BuildConfig.model_validate(_known_keys(dict(preset(DEFAULT_METHOD)), BuildConfig))
    if not isinstance(config, BuildConfig):
        raise ConfigError(
            f"config must be a segloc.Config, not {type(config).__name__}; pass poses as poses=..."
        )
    return config


BuildConfigT = TypeVar("BuildConfigT", bound=BuildConfig)


def stored_config(prior_map: SegmentMap, model: type[BuildConfigT]) -> BuildConfigT:
    """Return the configuration a map was built with, except threads and the sensor's mount.

    Parameters
    ----------
    prior_map : SegmentMap
        If it was merged from maps of different configurations, the first one is returned. If this
        version cannot read it, the preset of its method is.
    model : type
        :class:`BuildConfig` or a subclass.
    """
    parsed: BuildConfigT | None = _parse(stored_text(prior_map), prior_map.descriptor, model)
    if parsed is not None:
        return parsed
    values = {"method": prior_map.descriptor, **preset(prior_map.descriptor)}
    return model.model_validate(_known_keys(values, model))


def stored_text(prior_map: SegmentMap) -> str:
    """Return the configuration of a map as YAML; the first of several, "" if it has none."""
    return prior_map.metadata.get("config", "").split(TEXT_SEPARATOR)[0]


@lru_cache(maxsize=8)  # tiles of a map share one text, and YAML is slow to parse
def _parse(text: str, method: str, model: type[BuildConfigT]) -> BuildConfigT | None:
    if len(text) > _MAX_CHARACTERS:  # map files are untrusted
        return None
    try:
        values = parse_yaml(text, "the map") or {}
        stored = model.model_validate(_known_keys({**values, "threads": 0}, model))
    except (ConfigError, ValueError, TypeError, AttributeError, ArithmeticError):
        return None
    return without_mount(stored) if stored.method == method else None


def _known_keys(values: Mapping[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Return the values of keys that this version knows, in sections too."""
    known = {}
    for key, value in values.items():
        if (field := model.model_fields.get(key)) is None:
            continue
        kind = field.annotation
        if isinstance(value, Mapping) and isinstance(kind, type) and issubclass(kind, BaseModel):
            value = _known_keys(value, kind)
        known[key] = value
    return known


def without_mount(config: BuildConfigT) -> BuildConfigT:
    """Return the configuration without the sensor's mount, which belongs to the robot."""
    local_cloud = config.local_cloud.model_copy(update={"mount": MountConfig()})
    return config.model_copy(update={"local_cloud": local_cloud})
