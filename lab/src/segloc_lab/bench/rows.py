"""Rows of measurements as lines of text and as tables of reports."""

from __future__ import annotations

from collections.abc import Sequence

from ..report import Cell, Table
from .harness import OURS, Row

COLUMNS = ("what", "threads", "ours (ms)", "rivals (times ours)", "bound (ms)")
STREAM_COLUMNS = (
    "sensor",
    "points of a scan",
    "adding (ms)",
    "cloud of a query (ms)",
    "the rest of a query (ms)",
    "a scan, queries included (ms)",
    "gathering anew (times ours)",
    "localized",
)
SENSORS = {"stream": "HDL-64E", "stream_os1_128": "Ouster OS1-128", "stream_vlp16": "VLP-16"}
"""Of the streams."""
QUERY_COLUMNS = (
    "method",
    "map segments",
    "threads",
    "local cloud",
    "segmentation",
    "preparation",
    "description",
    "matching",
    "pose",
    "verification",
    "**total (ms)**",
    "found",
    "elsewhere (ms)",
)
_STAGES = (
    "local cloud",
    "segmentation",
    "preprocessing",
    "descriptor",
    "matching",
    "pose",
    "verification",
)


def table_rows(row: Row) -> list[tuple[str, str, str]]:
    """(what, ms, how many times ours) of ours, of every rival and of the bound."""
    threads = f"{row.threads} thread{'s' if row.threads > 1 else ''}"
    rows = [(f"{row.name}, {threads}", _ms(row.ours_ms), "1.0")]
    rows += [(f"  {name}", _ms(ms), ratio) for name, ms, ratio in rivals_of(row)]
    if row.bound_ms is not None:
        rows.append((f"  bound: {row.bound}", _ms(row.bound_ms), _ratio(row.bound_ms, row.ours_ms)))
    return rows


def rivals_of(row: Row) -> list[tuple[str, float, str]]:
    """(name, ms, how many times ours) of every rival, the fastest first."""
    ordered = sorted(row.rivals.items(), key=lambda item: item[1])
    return [(name, ms, _ratio(ms, row.ours_ms)) for name, ms in ordered]


def rounded(value: float) -> float:
    """Three digits are as many as two runs share."""
    return float(f"{value:.3g}")


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _ratio(theirs: float, ours: float) -> str:
    return f"{theirs / ours:.1f}" if theirs > ours else f"{theirs / ours:.2f}"


def show(rows: Sequence[Row]) -> None:
    """Print rows as lines of text."""
    for row in rows:
        for what, ms, ratio in table_rows(row):
            print(f"{what:<60} {ms:>9} ms {ratio:>8}")
        print("".join(f"    {name}: {value:.5g}\n" for name, value in row.details.items()), end="")
        if row.skipped:
            print(f"    not installed: {', '.join(row.skipped)}")


def tables(rows: Sequence[Row]) -> list[Table]:
    """Tabulate what ``segloc bench`` measured: kernels and queries, and streams on one thread."""
    kernels = [_kernel(row) for row in rows if row.name not in SENSORS]
    streams = [_stream(row) for row in rows if row.name in SENSORS and row.threads == 1]
    found = [Table(COLUMNS, kernels, title="Kernels and queries")] if kernels else []
    return [*found, *([Table(STREAM_COLUMNS, streams, title="Streams")] if streams else [])]


def query_table(rows: Sequence[tuple[str, Row]]) -> Table:
    """Tabulate what ``bench.kitti_query`` measured: rows with their methods."""
    return Table(QUERY_COLUMNS, [_query(method, row) for method, row in rows])


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
