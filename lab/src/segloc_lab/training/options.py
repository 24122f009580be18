"""The configuration of a training run from a file and a command line."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from segloc.config import validated
from segloc.errors import MissingDependency
from segloc.system.section import read_yaml

from .config import TrainConfig

PUBLISHED: dict[str, dict[str, Any]] = {"segmap": {"learning_rate": 1e-4, "hard_share": 0.0}}
"""What a network's own paper sets, where it is not the default here."""


def require_torch() -> None:
    """Say what to install before anything else is done.

    Raises
    ------
    MissingDependency
        If there is no PyTorch.
    """
    if find_spec("torch") is None:
        raise MissingDependency("torch", "train", "training")


def load_train_config(path: Path | None, given: dict[str, Any]) -> TrainConfig:
    """A configuration file, if there is one, with what the command line gives on top.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a name or a value is wrong.
    """
    values = {**({} if path is None else read_yaml(path)), **given}
    published = PUBLISHED.get(str(values.get("network", "dsm")), {})
    return validated(TrainConfig, {**published, **values}, str(path or "training"))
