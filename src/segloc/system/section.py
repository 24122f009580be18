"""Sections of the configuration, and their YAML.

A section rejects unknown keys, NaN, infinity and invalid values; YAML must be small, flat and
without references.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import ConfigError

SectionT = TypeVar("SectionT", bound="Section")


_MAX_LENGTH = 100_000  # characters; the whole configuration with comments has 6000
_MAX_DEPTH = 20


class Section(BaseModel):
    """A section of the configuration, or of a file beside the weights.

    Raises
    ------
    ConfigError
        If a key is unknown or a value is out of range; names the key.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise _config_error(type(self), error) from error

    # Nested sections are validated without it, so that faults keep their full keys.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def model_validate(cls: type[SectionT], obj: Any, **options: Any) -> SectionT:
        """Validate a mapping of values; ``options`` are pydantic's."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise _config_error(cls, error) from error

    def model_copy(
        self: SectionT, *, update: Mapping[str, Any] | None = None, deep: bool = False
    ) -> SectionT:
        """Return a copy with other values for some keys, which are checked."""
        copied = super().model_copy(deep=deep)
        return type(self).model_validate({**dict(copied), **update}) if update else copied


def _config_error(model: type[BaseModel], error: ValidationError) -> ConfigError:
    """Return the first fault in one line: key, fault, value."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return ConfigError(f"{key}: no such key{_meant(model, key)}")
    given = first.get("input")
    shown = f", not {given!r:.60}" if isinstance(given, (bool, int, float, str)) else ""
    return ConfigError(f"{key}: {first['msg']}{shown}")


def _meant(model: type[BaseModel], key: str) -> str:
    """Suggest the key meant by an unknown one."""
    keys = list(_keys(model))
    last = key.rpartition(".")[2]
    same = [each for each in keys if each.rpartition(".")[2] == last]
    near = same or get_close_matches(key, keys, 1, 0.7)
    if not near:
        names = {each.rpartition(".")[2]: each for each in keys}
        near = [names[name] for name in get_close_matches(last, names, 1, 0.7)]
    return f": did you mean {near[0]}?" if near else ": `segloc config --all` lists all keys"


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, info in model.model_fields.items():
        yield f"{prefix}{name}"
        # Not issubclass: on Python 3.10 list[int] passes for a class, and is none.
        if isinstance(info.annotation, type(BaseModel)):
            yield from _keys(info.annotation, f"{prefix}{name}.")


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file as a mapping; an empty file gives an empty one.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not a YAML mapping, or as :func:`parse_yaml`.
    """
    try:
        special = path.exists() and not path.is_file()
        text = ""
        if not special:
            with path.open(encoding="utf-8") as file:
                text = file.read(_MAX_LENGTH + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # not UTF-8, or an invalid file name
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    if special:
        raise ConfigError(f"{path}: not a regular file")
    values = parse_yaml(text, str(path))
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected a mapping of sections")
    return values


def parse_yaml(text: str, where: str) -> Any:
    """Parse YAML.

    Raises
    ------
    ConfigError
        If it is not YAML, too long, nested too deeply, or has references (``*name``), by which a
        few lines can expand to billions; names ``where``.
    """
    if len(text) > _MAX_LENGTH:
        raise ConfigError(f"{where}: longer than {_MAX_LENGTH} characters: not a configuration")
    try:
        _check_events(text, where)
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{where}: not YAML ({str(error).splitlines()[0]})") from error
    except (ValueError, TypeError, LookupError, OverflowError, AttributeError) as error:
        # Values that look like invalid numbers or dates.
        raise ConfigError(f"{where}: not YAML ({error})") from error


def _check_events(text: str, where: str) -> None:
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ConfigError(f"{where}: references (*{event.anchor}) are not supported")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise ConfigError(f"{where}: nested deeper than {_MAX_DEPTH} levels")
