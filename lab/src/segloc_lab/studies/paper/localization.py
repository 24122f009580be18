"""How many queries each method localizes, and how many of them falsely (Table II of the paper)."""

from __future__ import annotations

from ...evaluation.comparison_study import compare
from ...evaluation.report.study import Study
from . import published
from .scenarios import scenarios
from .workspace import Workspace


def run(workspace: Workspace) -> Study:
    """Localize the queries of all scenarios of a workspace.

    See :func:`~segloc_lab.studies.paper.scenarios.scenarios`.

    Raises
    ------
    SeglocError
        If a recording cannot be read, or results cannot be written.
    """
    found = scenarios(workspace)
    return compare(workspace, found, "localization", "Localization", [published.localizations()])
