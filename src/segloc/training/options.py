"""The configuration of a training run from a file and a command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from ..errors import ConfigError
from .config import TrainConfig

PUBLISHED: dict[str, dict[str, Any]] = {"segmap": {"learning_rate": 1e-4, "hard_share": 0.0}}
"""What a network's own paper sets, where it is not the default here."""


def load_train_config(path: Path | None, given: dict[str, Any]) -> TrainConfig:
    """A configuration file, if there is one, with what the command line gives on top.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a name or a value is wrong.
    """
    values: dict[str, Any] = {}
    if path is not None:
        try:
            values = yaml.safe_load(path.read_text("utf-8")) or {}
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise ConfigError(f"{path}: {error}") from error
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: not a mapping of names to values")
    try:
        network = given.get("network", values.get("network", "dsm"))
        return TrainConfig(**{**PUBLISHED.get(network, {}), **values, **given})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{path or 'training'}: {where}: {first['msg']}") from error
