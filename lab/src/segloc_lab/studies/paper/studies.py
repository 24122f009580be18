"""The studies by name, in the order of the report."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import cast

from ...evaluation.report.study import Study
from .workspace import Workspace

STUDIES = (
    "roc",
    "generalization",
    "rotation",
    "sampling",
    "localization",
    "timing",
    "memory",
)
"""Each is run by the module of its name in this package."""


def run(name: str, workspace: Workspace) -> Study:
    """Run one of :data:`STUDIES` and store it in a folder of the workspace.

    Raises
    ------
    SeglocError
        Whatever is the user's to mend: data that cannot be read, packages that are missing, a
        folder that cannot be written.
    """
    module = importlib.import_module(f"{__package__}.{name}")
    study = cast(Callable[[Workspace], Study], module.run)(workspace)
    study.save(workspace.out / study.name)
    return study
