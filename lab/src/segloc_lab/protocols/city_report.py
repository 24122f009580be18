"""What ``large_city`` has measured, in lines of its table."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..evaluation.intervals import share
from .city_queries import WAYS, WIDE

Line = tuple[str, str]


def lines(known: dict[str, Any], records: list[dict[str, Any]], workers: int) -> list[Line]:
    """All of them: of what is in the city's ``city.json``, and in the records of its towns."""
    found = _built(records)
    if cut := known.get("cut"):
        found += _cut(cut, sum(r["km"] for r in records))
    found += _scaled(known, workers)
    if "wide" in known:
        found.append((f"segments of the thin map {WIDE}, by copies", str(known["wide"])))
    for way in WAYS:
        if way in known and known[way]["answers"]:
            found += _answered(way, known[way])
    return found


def concise(known: dict[str, Any]) -> dict[str, Any]:
    """The same with a line an answer: the query, its outcome, and milliseconds, anew and again."""
    found = {name: value for name, value in known.items() if name != "records"}
    for way in WAYS:
        if way in found:
            found[way] = [
                f"{a['query']} {a['outcome']} {a['search_ms']:.0f} {a['again_ms']:.0f}"
                for a in found[way]["answers"]
            ]
    return found


def _built(records: list[dict[str, Any]]) -> list[Line]:
    km, streets = (sum(r[name] for r in records) for name in ("km", "streets_km"))
    described, segments = (sum(r[name] for r in records) for name in ("described", "segments"))
    world, mapped = (sum(r[name] for r in records) for name in ("world_s", "map_s"))
    megabytes = sum(r["bytes"] for r in records) / 1e6
    seeds = [r["seed"] for r in records]
    return [
        ("towns, and their seeds", f"{len(records)}, {min(seeds)} to {max(seeds)}"),
        ("km driven, of them streets driven for the first time", f"{km:.1f}, {streets:.1f}"),
        ("segments described, and kept in their maps", f"{described}, {segments}"),
        ("MB a km", f"{megabytes / km:.2f}"),
        ("processor s a km: making the towns", f"{world / km:.1f}"),
        ("processor s a km: scans cast, and mapped", f"{mapped / km:.1f}"),
        ("km mapped an hour and core, scans cast included", f"{3600 * km / mapped:.0f}"),
        ("km an hour and core, making the towns included", f"{3600 * km / (world + mapped):.0f}"),
    ]


def _cut(cut: dict[str, Any], km: float) -> list[Line]:
    wall_s, cpu_s = cut["all_s"]
    tiles_mb, thin_mb = (size / 1e6 for size in cut["bytes"])
    return [
        ("tiles", f"{cut['tiles']} of {tiles_mb:.1f} MB together"),
        ("segments in them, each once, and in the thin map", f"{cut['segments']}, {cut['thin']}"),
        ("MB of the thin map", f"{thin_mb:.1f}"),
        ("processor s a km, s in all: joined and cut", f"{cpu_s / km:.1f}, {wall_s:.0f}"),
    ]


def _scaled(known: dict[str, Any], most: int) -> list[Line]:
    """How much of one worker's pace each of several has, where each does the same."""
    if "workers 1" not in known:
        return []
    alone = known["workers 1"]["wall_s"]
    several = (n for n in sorted({2, most} - {1}) if f"workers {n}" in known)
    found = {n: known[f"workers {n}"]["wall_s"] for n in several}
    return [
        (f"efficiency of {n} workers", f"{100 * alone / wall:.0f} %") for n, wall in found.items()
    ]


def _answered(way: str, asked: dict[str, Any]) -> list[Line]:
    answers = asked["answers"]
    outcomes = [answer["outcome"] for answer in answers]
    total, found, false = len(answers), outcomes.count("found"), outcomes.count("false")

    def spread(values: list[float]) -> str:
        return f"{np.median(values):.0f} / {np.quantile(values, 0.95):.0f} / {np.mean(values):.0f}"

    columns = ("search_ms", "again_ms", "describe_ms")
    search, again, described = ([answer[name] for answer in answers] for name in columns)
    right = [] if way.startswith("elsewhere") else [(f"{way}: found", share(found, total))]
    return [
        *right,
        (f"{way}: false", share(false, total)),
        (f"{way}: description, processor ms, median / 95 % / mean", spread(described)),
        (f"{way}: search, tiles opened anew", spread(search)),
        (f"{way}: search, tiles in memory", spread(again)),
        (
            f"{way}: most MB resident, and before the first query",
            f"{asked['peak_mb']:.0f}, {asked['ready_mb']:.0f}",
        ),
    ]
