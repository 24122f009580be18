"""The studies by name, in the order of the report."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import cast

from segloc.batch.report.study import Study

from .workspace import Workspace

MODULES: Mapping[str, str] = {
    "roc": "roc",
    "generalization": "generalization",
    "rotation": "rotation",
    "sampling": "sampling",
    "localization": "localization_study",
    "timing": "timing",
    "memory": "memory",
}
"""Which module of this package runs a study."""

STUDIES = tuple(MODULES)


def run(name: str, workspace: Workspace) -> Study:
    """Run one of :data:`STUDIES` and store it in a folder of the workspace.

    Raises
    ------
    SeglocError
        Whatever is the user's to mend: data that cannot be read, packages that are missing, a
        folder that cannot be written.
    """
    module = importlib.import_module(f"{__package__}.{MODULES[name]}")
    study = cast(Callable[[Workspace], Study], module.run)(workspace)
    study.save(workspace.out / study.name)
    return study
