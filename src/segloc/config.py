"""The whole configuration: the stages' own sections, composed, and one preset a method."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from . import descriptors
from .errors import ConfigError
from .local_cloud import LocalCloudConfig
from .map.build import MappingConfig
from .matching import MatchingConfig
from .pose import PoseConfig
from .segmentation import SegmentationConfig
from .verification.verifier import VerificationConfig

DEFAULT_METHOD = "profile"

Model = TypeVar("Model", bound=BaseModel)


class Config(BaseModel):
    """Everything that can be set. Frozen: derive a changed one with ``model_copy(update=...)``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: str = Field(DEFAULT_METHOD, description="how segments are described; see descriptors/")
    threads: int = Field(0, ge=0, description="0: all cores; results do not depend on it")
    seed: int = Field(0, ge=0, description="of the estimators that draw samples")
    local_cloud: LocalCloudConfig = LocalCloudConfig()
    segmentation: SegmentationConfig = SegmentationConfig()
    mapping: MappingConfig = MappingConfig()
    matching: MatchingConfig = MatchingConfig()
    pose: PoseConfig = PoseConfig()
    verification: VerificationConfig = VerificationConfig()

    @classmethod
    def preset(cls, method: str) -> Config:
        """The configuration a method is at its best with.

        Raises
        ------
        ConfigError
            If there is no such method.
        """
        if method not in descriptors.available():
            raise ConfigError(
                f"no method {method!r}; there are {', '.join(descriptors.available())}"
            )
        return cls.model_validate({"method": method, **descriptors.preset(method)})

    @classmethod
    def load(cls, path: str | Path | None, method: str | None = None) -> Config:
        """Read a YAML file; what it leaves out comes from the preset of its method.

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
        merged = _merged(preset.model_dump(), {**values, "method": preset.method})
        return validated(cls, merged, str(path))

    def to_yaml(self) -> str:
        """The whole configuration as YAML, with every default written out."""
        text: str = yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
        return text


def validated(model: type[Model], values: Mapping[str, Any], where: str) -> Model:
    """A section of configuration from its values, which come from ``where``.

    Raises
    ------
    ConfigError
        If a key is unknown or a value out of range; names ``where`` and the key.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{where}: {key}: {first['msg']}") from error


def read_yaml(path: Path) -> dict[str, Any]:
    """What a YAML file maps names to; nothing if it is empty.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no YAML mapping.
    """
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not YAML ({str(error).splitlines()[0]})") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected a mapping of sections")
    return values


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        both = isinstance(old, dict) and isinstance(value, dict)
        merged[key] = _merged(old, value) if both else value  # type: ignore[arg-type]
    return merged
