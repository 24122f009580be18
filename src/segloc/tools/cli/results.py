"""Write output folders atomically, and maps under a lock."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import MissingDependency, SeglocError
from ...map.georeference import KEY, Georeference
from ...map.identity import MAP_ID, map_id
from ...map.info import CLOUD_FRAME
from ...system.files import checked_target, replacing, require_permission
from ...system.locks import exclusive
from ...system.text import json_text
from ...types import Float64, Int64
from ..io import Trajectory, tum_text
from .console import note

if TYPE_CHECKING:
    from ...map.segment_map import SegmentMap
    from ..batch.score import Evaluation


_POSES, _SUMMARY = "poses.tum", "summary.json"
_RESULTS = _POSES, "localizations.jsonl", "states.jsonl", "trajectory.png", "errors.png"
"""Files of results, besides the summary."""


def check_folder(out: Path) -> None:
    """Reject a folder that cannot be written or holds other poses, before the work starts."""
    nearest = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise SeglocError(f"{out}: cannot be written: {nearest} is not a folder")
    require_permission(out, nearest)
    if (out / _POSES).exists() and not (out / _SUMMARY).exists():
        raise SeglocError(f"{out}: its {_POSES} is no result of segloc: choose another folder")


def write_results(
    out: Path, prior_map: SegmentMap, evaluation: Evaluation, more: Mapping[str, bytes]
) -> list[str]:
    """Write ``poses.tum``, ``localizations.jsonl``, ``summary.json``, and ``more`` files.

    Returns
    -------
    list of str
        Names of the files, and of folders of others.
    """
    files = {**_contents(evaluation, prior_map), **more}
    write_together(out, files)
    tops = (name.partition("/") for name in files)
    return list(dict.fromkeys(top + slash for top, slash, _ in tops))


def pictures(prior_map: SegmentMap, evaluation: Evaluation, title: str) -> dict[str, bytes]:
    """Draw ``trajectory.png``, and with true poses ``errors.png``.

    Without matplotlib nothing is drawn, and a note says so.
    """
    from ..batch.picture import draw, draw_errors

    try:
        drawn = {"trajectory.png": draw(prior_map, evaluation, title)}
        if evaluation.truths is not None and evaluation.correct.any():
            drawn["errors.png"] = draw_errors(prior_map, evaluation, title)
    except MissingDependency as error:
        note(f"trajectory.png not written: {error}")
        return {}
    return drawn


def print_json(evaluation: Evaluation) -> None:
    """Print the results and their summary as one JSON object."""
    found = {"summary": evaluation.summary(), "queries": list(evaluation.records())}
    print(json_text(found))


def map_facts(prior_map: SegmentMap) -> dict[str, Any]:
    """Return identity, georeference, and transform from the cloud of a map, if it has them."""
    facts: dict[str, Any] = {}
    if len(prior_map.cloud):  # not in tiles
        facts[MAP_ID] = map_id(prior_map)
    if (where := Georeference.of(prior_map.metadata)) is not None:
        facts[KEY] = json.loads(where.to_text())
    if CLOUD_FRAME in prior_map.metadata:
        facts[CLOUD_FRAME] = prior_map.T_map_cloud.tolist()
    return facts


def _contents(evaluation: Evaluation, prior_map: SegmentMap) -> dict[str, bytes]:
    lines = [json.dumps(record, allow_nan=False) + "\n" for record in evaluation.records()]
    found = evaluation.summary() | map_facts(prior_map)
    summary = json.dumps(found, indent=2, allow_nan=False) + "\n"
    return {
        _POSES: _poses(evaluation),
        "localizations.jsonl": "".join(lines).encode(),
        _SUMMARY: summary.encode(),
    }


def tum_bytes(numbers: Int64, stamps: Float64 | None, poses: Float64) -> bytes:
    """Return a TUM file of poses by stamp, or else by scan number, with a remark."""
    keys = numbers.astype(np.float64) if stamps is None else stamps
    remark = "no times: the first column is the scan number" if stamps is None else ""
    return tum_text(_POSES, Trajectory(keys, poses), remark).encode()


def _poses(evaluation: Evaluation) -> bytes:
    """Return a TUM file of the localized poses, in the order of their stamps or numbers."""
    numbers, stamps = evaluation.indices[evaluation.localized], evaluation.stamps
    if stamps is not None:
        stamps = stamps[evaluation.localized]
    order = np.argsort(numbers if stamps is None else stamps)
    poses = evaluation.positions_found()[order]
    return tum_bytes(numbers[order], None if stamps is None else stamps[order], poses)


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Lock ``out`` for writing; if it is locked, note it and wait."""
    checked_target(out)
    with exclusive(out, lambda: note(f"{out}: waiting for another process that writes it")):
        yield


def write_together(out: Path, files: dict[str, bytes]) -> None:
    """Write the results of a folder and its subfolders: all or none, in place of earlier ones."""
    from ..inspect.results import DEBUG

    old = [*(out / name for name in _RESULTS), *(out / DEBUG).glob("*.npz")]
    stale = {path for path in old if path.is_file()} if (out / _SUMMARY).exists() else set()
    folders = sorted({(out / name).parent for name in files} | {out})
    made = [folder for folder in folders if not folder.exists()]
    for folder in made:
        folder.mkdir(parents=True)
    try:
        with ExitStack() as stack:  # nothing is renamed before everything is written
            for name, data in files.items():
                stack.enter_context(replacing(out / name)).write(data)
    except BaseException:
        for folder in reversed(made):
            with suppress(OSError):
                folder.rmdir()
        raise
    for path in stale - {out / name for name in files}:
        path.unlink(missing_ok=True)
