"""Sections of the configuration, and the YAML they are read from.

A section refuses unknown keys, NaN and infinity; YAML is small, flat and without references.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict

from ..errors import ConfigError

_LONGEST = 100_000  # characters; the whole configuration with its comments has 6000
_DEEPEST = 20


class Section(BaseModel):
    """A section of the configuration, or of a file beside the weights."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def read_yaml(path: Path) -> dict[str, Any]:
    """What a YAML file maps names to; nothing if it is empty.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no YAML mapping, or as :func:`parse_yaml`.
    """
    try:
        if path.exists() and not path.is_file():
            raise ConfigError(f"{path}: cannot be read (not a file)")
        with path.open(encoding="utf-8") as file:
            text = file.read(_LONGEST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # not UTF-8, or no name of a file
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    values = parse_yaml(text, str(path))
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected a mapping of sections")
    return values


def parse_yaml(text: str, where: str) -> Any:
    """What a text in YAML says.

    Raises
    ------
    ConfigError
        If it is no YAML, too long, nested too deep, or refers to itself (``*name``), by which a
        few lines can stand for billions; names ``where``.
    """
    if len(text) > _LONGEST:
        raise ConfigError(f"{where}: longer than {_LONGEST} characters: no configuration")
    try:
        _check_events(text, where)
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{where}: not YAML ({str(error).splitlines()[0]})") from error
    except (ValueError, TypeError, LookupError, OverflowError, AttributeError) as error:
        # Values that look like numbers or dates, and are none.
        raise ConfigError(f"{where}: not YAML ({error})") from error


def _check_events(text: str, where: str) -> None:
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ConfigError(f"{where}: references (*{event.anchor}) are not supported")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise ConfigError(f"{where}: nested deeper than {_DEEPEST} levels")
