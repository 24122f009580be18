"""How many queries each method localizes, and how many of them falsely (Table II of the paper)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from ..config import Config
from ..types import Float64
from . import asking, published
from .asking import ESTIMATORS, Job
from .cache import load_arrays, load_json, save_arrays, save_json
from .courses import Course, courses
from .localization_maps import maps
from .localization_tables import Result, details, summaries
from .methods import Methods, ready
from .pool import in_parallel
from .study import Study
from .workspace import Workspace

Settings = dict[str, Any]

TEXT = """\
A map is made of a first traversal, and a later one is asked, one cloud after another: where in this
map was the sensor? No query knows the one before it, and none has an initial guess. An answer is
right within 3 m and 5 degrees of the truth; any other answer is false. A query has a place if the
map's way leads past it within 3 m: the others come from streets that the map does not hold, and are
best left unanswered.

All methods see the same segments and the same thresholds, those of the package: fitted once on
simulated worlds and on real scans in wrong maps, a few of them set by hand with KITTI 00 in view.
They are asked twice, with our pose estimator (consensus) and with the paper's (PROSAC), and once
more in the map of another place, seen by the same kind of sensor, where every answer is false."""


def run(workspace: Workspace) -> Study:
    """Ask all courses of a workspace (see :func:`~segloc.evaluation.courses.courses`).

    Raises
    ------
    SeglocError
        If a recording cannot be read, or results cannot be written.
    """
    start = time.perf_counter()
    methods = ready(workspace.methods)
    results = asked(workspace, methods)
    own = workspace.sequences is not None
    tables = [table for name in ESTIMATORS for table in summaries(results, methods, name)]
    tables = tables if own else [tables[0], published.localizations(), *tables[1:]]
    return Study(
        "own" if own else "localization",
        "Localization of your own recordings" if own else "Localization",
        (*tables, details(results, methods)),
        tuple(maps(results, methods)),
        workspace.facts(time.perf_counter() - start, methods.fingerprints),
        TEXT,
    )


def asked(workspace: Workspace, methods: Methods) -> list[Result]:
    """The answers of all methods on all courses; those that are stored are not asked again."""
    results = [_stored(workspace, course, methods) for course in courses(workspace)]
    jobs = [
        Job(result.course, missing, workspace.threads)
        for result in results
        if (missing := tuple(name for name in methods.names if name not in result.answers))
    ]
    with workspace.progress("Localizing") as update:
        update(0, len(jobs))
        finished = in_parallel(asking.done, jobs, workspace.workers)
        for count, (job, answers, arrays) in enumerate(finished):
            place = next(k for k, r in enumerate(results) if r.course == job.course)
            results[place] = Result(job.course, {**results[place].answers, **answers}, arrays)
            _keep(workspace, job, methods, answers, arrays)
            update(count + 1, len(jobs))
    return results


def _stored(workspace: Workspace, course: Course, methods: Methods) -> Result:
    settings = course.settings()
    arrays = workspace.find(*_key(course, settings), load_arrays)
    if arrays is None:
        return Result(course, {}, {})
    found = {
        name: workspace.find(*_method_key(course, settings, methods, name), load_json)
        for name in methods.names
    }
    return Result(course, {name: value for name, value in found.items() if value}, arrays)


def _keep(
    workspace: Workspace,
    job: Job,
    methods: Methods,
    answers: Mapping[str, Any],
    arrays: Mapping[str, Float64],
) -> None:
    settings = job.course.settings()
    for name in job.methods:
        key = _method_key(job.course, settings, methods, name)
        workspace.keep(*key, answers[name], save_json)
    workspace.keep(*_key(job.course, settings), arrays, save_arrays)


def _key(course: Course, settings: Settings) -> tuple[str, Settings]:
    config = Config(threads=0).model_dump(mode="json")
    return f"course-{course.name}", {"course": settings, "config": config}


def _method_key(
    course: Course, settings: Settings, methods: Methods, name: str
) -> tuple[str, Settings]:
    config = asking.shared_config(name, 0).model_dump(mode="json")
    decides = {"course": settings, "config": config, "method": methods.fingerprints[name]}
    return f"localization-{course.name}-{name}", decides
