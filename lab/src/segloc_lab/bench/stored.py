"""Measurements as results that the pages of the documentation show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from segloc.map.config import DEFAULT_METHOD

from ..results.fingerprints import FOLLOWING, LOCALIZING
from ..results.store import Cell, Result
from .harness import OURS, Row
from .rows import rivals_of, rounded

COLUMNS = ("what", "threads", "ours (ms)", "rivals (times ours)", "bound (ms)")
STREAM_COLUMNS = (
    *("sensor", "points of a scan", "adding (ms)", "cloud of a query (ms)"),
    *("the rest of a query (ms)", "a scan, queries included (ms)", "gathering anew (times ours)"),
    "localized",
)
SENSORS = {"stream": "HDL-64E", "stream_os1_128": "Ouster OS1-128", "stream_vlp16": "VLP-16"}
"""Of the streams."""
QUERY_COLUMNS = (
    *("method", "map segments", "threads", "local cloud", "segmentation", "preparation"),
    *("description", "matching", "pose", "verification", "**total (ms)**", "found"),
    "elsewhere (ms)",
)
_STAGES = (
    *("local cloud", "segmentation", "preprocessing", "descriptor", "matching", "pose"),
    "verification",
)


def stored(rows: Sequence[Row], command: str, machine: str) -> list[Result]:
    """What ``segloc bench`` measured: kernels and queries, and streams, where there are any."""
    kernels = [row for row in rows if row.name not in SENSORS]
    streams = [row for row in rows if row.name in SENSORS and row.threads == 1]
    found = []
    if kernels:
        cells = [_kernel(row) for row in kernels]
        found.append(_result("bench", command, COLUMNS, cells, kernels, machine))
    if streams:
        cells = [_stream(row) for row in streams]
        found.append(
            _result("streams", command, STREAM_COLUMNS, cells, streams, machine, FOLLOWING)
        )
    return found


def stored_queries(rows: Sequence[tuple[str, Row]], command: str, machine: str) -> Result:
    """What ``bench.kitti_query`` measured: rows with their methods."""
    cells = [_query(method, row) for method, row in rows]
    measured = [row for _, row in rows]
    return _result("kitti-query", command, QUERY_COLUMNS, cells, measured, machine)


def stored_network(rows: Sequence[Row], command: str, machine: str) -> Result:
    """What ``bench.methods`` measured of SegMap's network: rows of threads."""
    cells = [_kernel(row) for row in rows]
    return _result("voxel-network", command, COLUMNS, cells, rows, machine, ("descriptors",), ())


def _result(
    name: str,
    command: str,
    columns: Sequence[str],
    cells: list[tuple[Cell, ...]],
    rows: Sequence[Row],
    machine: str,
    stages: Sequence[str] = LOCALIZING,
    methods: Sequence[str] = (DEFAULT_METHOD,),
) -> Result:
    kept = {"machine": machine, "rows": [asdict(row) for row in rows]}
    note = f"Machine: {machine}."
    return Result.measured(
        name, command, columns, cells, stages=stages, methods=methods, note=note, counts=kept
    )


def _kernel(row: Row) -> tuple[Cell, ...]:
    rivals = "; ".join(f"{name} {ratio}x" for name, _, ratio in rivals_of(row))
    bound = None
    if row.bound_ms is not None:
        bound = f"{row.bound_ms:.2f} ({100 * row.bound_ms / row.ours_ms:.0f} % of ours)"
    return f"`{row.name}`", row.threads, rounded(row.ours_ms), rivals or None, bound


def _stream(row: Row) -> tuple[Cell, ...]:
    found, (rival,) = row.details, row.rivals.values()
    names = ("adding and dropping, ms a scan", "local cloud, ms a query")
    parts = (*(found[name] for name in names), found["total of the rest of a query, ms"])
    correct = round(found[f"correct, {OURS}"])
    return (
        SENSORS[row.name],
        round(found["points of a scan"]),
        *map(rounded, (*parts, row.ours_ms)),
        round(rival / row.ours_ms, 1),
        f"{correct} of {found['queries']:.0f}",
    )


def _query(method: str, row: Row) -> tuple[Cell, ...]:
    found = row.details
    stages = (round(found[f"{name}, ms"], 1) for name in _STAGES)
    share = f"{found['correct']:.0f} of {found['queries']:.0f}"
    segments = round(found["map segments"])
    elsewhere = found.get("elsewhere, ms")
    times = None if elsewhere is None else f"{elsewhere:.1f} ({elsewhere / row.ours_ms:.1f}x)"
    return method, segments, row.threads, *stages, round(row.ours_ms, 1), share, times
