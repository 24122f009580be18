"""How many queries each method localizes, and how many of them falsely."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from typing import Any

from segloc.config import Config
from segloc.types import Float64

from . import comparison
from .cache import load_arrays, load_json, save_arrays, save_json
from .comparison import ESTIMATORS
from .comparison_maps import maps
from .comparison_pieces import Job, answers_of, make_maps
from .comparison_tables import Result, details, differences, summaries
from .methods import Methods, ready
from .report.study import Study, Table
from .scenario import Pair, PairScenario, Scenario
from .workspace import Workspace

Settings = dict[str, Any]

TEXT = """\
A map is made of a first traversal, and clouds of a later one are localized in it, one after
another. No query knows the one before it, and none has an initial guess. An answer is right within
3 m and 5 degrees of the truth; any other answer is false. A query lies within map coverage if the
map's path passes it within 3 m: the others come from streets that the map does not hold, and are
best left unanswered.

All methods see the same segments and the same thresholds, those of the package: fitted once on
simulated worlds and on real scans in wrong maps, a few of them set by hand with KITTI 00 in view.
Each query is made twice, with our pose estimator (consensus) and with the published one, and,
where there is one, in the map of another place, seen by the same kind of sensor: there every answer
is false."""
ALONE = """

Here segments alone make candidates. As segloc is shipped it also searches by stems and by what
stands where, which find nearly all that a method's segments lose, and so hide what it is worth."""


def own_recordings(workspace: Workspace, pair: Pair) -> Study:
    """Compare the methods on two recordings of the user's own.

    Raises
    ------
    SeglocError
        If a recording cannot be read, or results cannot be written.
    """
    title = "Localization of your own recordings"
    return compare(workspace, [PairScenario(pair)], "own", title)


def compare(
    workspace: Workspace,
    scenarios: Sequence[Scenario],
    name: str,
    title: str,
    published: Sequence[Table] = (),
) -> Study:
    """Localize the queries of all scenarios by all methods.

    Parameters
    ----------
    workspace : Workspace
    scenarios : sequence of Scenario
    name, title : str
        Of the study.
    published : sequence of Table
        Figures of others, to stand beside the first table.

    Raises
    ------
    SeglocError
        If a recording cannot be read, or results cannot be written.
    """
    start = time.perf_counter()
    methods = ready(workspace.methods)
    results = answered(workspace, scenarios, methods)
    tables = [
        table
        for make in (summaries, differences)
        for each in ESTIMATORS
        for table in make(results, methods, each)
    ]
    return Study(
        name,
        title,
        (tables[0], *published, *tables[1:], details(results, methods)),
        tuple(maps(results, methods)),
        workspace.facts(time.perf_counter() - start, methods.fingerprints),
        TEXT + ALONE if all(each.segments_alone for each in scenarios) else TEXT,
    )


def answered(workspace: Workspace, scenarios: Sequence[Scenario], methods: Methods) -> list[Result]:
    """The answers of all methods on all scenarios; those that are stored are not computed again.

    A scenario is answered in pieces, each of which is kept when it is finished.
    """
    results = [_stored(workspace, scenario, methods) for scenario in scenarios]
    missing = {
        k: names
        for k, result in enumerate(results)
        if (names := tuple(name for name in methods.names if name not in result.answers))
    }
    jobs = [_job(workspace, results[k].scenario, names, methods) for k, names in missing.items()]
    make_maps(workspace, jobs)
    for k, job, answers in zip(missing, jobs, answers_of(workspace, jobs), strict=True):
        arrays = job.arrays()
        results[k] = Result(job.scenario, {**results[k].answers, **answers}, arrays)
        _keep(workspace, job, methods, answers, arrays)
        shutil.rmtree(job.maps, ignore_errors=True)
    return results


def _job(workspace: Workspace, scenario: Scenario, names: tuple[str, ...], methods: Methods) -> Job:
    settings = scenario.settings()
    keys = dict(_method_key(scenario, settings, methods, name) for name in names)
    maps = workspace.folder(f"maps-{scenario.name}", {"methods": keys})
    return Job(scenario, names, workspace.threads, maps)


def _stored(workspace: Workspace, scenario: Scenario, methods: Methods) -> Result:
    settings = scenario.settings()
    arrays = workspace.find(*_key(scenario, settings), load_arrays)
    if arrays is None:
        return Result(scenario, {}, {})
    found = {
        name: workspace.find(*_method_key(scenario, settings, methods, name), load_json)
        for name in methods.names
    }
    return Result(scenario, {name: value for name, value in found.items() if value}, arrays)


def _keep(
    workspace: Workspace,
    job: Job,
    methods: Methods,
    answers: Mapping[str, Any],
    arrays: Mapping[str, Float64],
) -> None:
    settings = job.scenario.settings()
    for name in job.methods:
        key = _method_key(job.scenario, settings, methods, name)
        workspace.keep(*key, answers[name], save_json)
    workspace.keep(*_key(job.scenario, settings), arrays, save_arrays)


def _key(scenario: Scenario, settings: Settings) -> tuple[str, Settings]:
    config = Config(threads=0).model_dump(mode="json")
    return f"scenario-{scenario.name}", {"scenario": settings, "config": config}


def _method_key(
    scenario: Scenario, settings: Settings, methods: Methods, name: str
) -> tuple[str, Settings]:
    config = comparison.shared_config(name, 0, scenario.segments_alone).model_dump(mode="json")
    decides = {"scenario": settings, "config": config, "method": methods.fingerprints[name]}
    return f"localization-{scenario.name}-{name}", decides
