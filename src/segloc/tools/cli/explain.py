"""``segloc explain``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...errors import ConfigError
from . import options
from .console import busy

if TYPE_CHECKING:
    from ...frontend.local_cloud import LocalCloudConfig
    from ...map.segment_map import SegmentMap
    from ...types import Recording
    from ..inspect import Trace


def explain(
    scan: Annotated[Path, typer.Argument(metavar="SCAN", help="File of one scan, or a recording.")],
    prior_map: Annotated[Path, typer.Option("--map", metavar="MAP.segmap", help="The prior map.")],
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also write a page with pictures.", show_default="none"),
    ] = None,
    select: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="NUMBER",
            help="Number of the scan in a recording.",
            show_default="the last",
        ),
    ] = None,
    poses: options.Poses = None,
    topic: options.Topic = None,
    odometry: options.Odometry = False,
    config: options.ConfigFile = None,
    weights: options.SameWeights = None,
    threads: options.Threads = 0,
) -> None:
    """Show the stages of one query, and why it is or is not localized.

    With poses or --odometry, the query is a cloud accumulated over the path behind the scan.
    """
    import numpy as np

    from ...system.files import checked_target
    from ...tiles import open_map
    from ..batch.run import query_clouds
    from ..inspect import trace
    from .recording import open_recording

    if html is not None:
        checked_target(html, ".html", ".htm")
    with busy("Loading the map"):
        localizer = options.open_localizer(open_map(str(prior_map)), config, threads, weights)
    local = localizer.config.local_cloud
    recording = open_recording(scan, poses, topic=topic, odometry=odometry, local=local)
    position = _position(recording, select)
    name = f"{recording.name}, scan {recording.indices[position]}, in {prior_map.name}"
    with busy("Localizing"):
        ((cloud, _),) = query_clouds(recording, np.array([position]), localizer.config)
        found = trace(localizer, cloud, name)
        findings = _findings(
            recording, position, local, None if found.result.localized else localizer.prior_map
        )
    if html is not None:
        from ...system.files import write_text
        from ..inspect.page import page

        with busy("Drawing"):
            write_text(html, page(found, findings))
    _show(found, findings)
    if html is not None:
        print(f"\npictures: {html}")


def _position(recording: Recording, number: int | None) -> int:
    if number is None:
        return len(recording) - 1
    found = [i for i, index in enumerate(recording.indices) if index == number]
    if not found:
        nearest = sorted(sorted(map(int, recording.indices), key=lambda k: abs(k - number))[:2])
        has = " and ".join(map(str, nearest))
        raise ConfigError(f"--select {number}: no such scan in {recording.name}; nearest are {has}")
    return found[0]


def _findings(
    recording: Recording,
    position: int,
    config: LocalCloudConfig,
    prior_map: SegmentMap | None,
) -> list[str]:
    """Return the findings of `segloc doctor` on a scan: faults, and advice if it has no pose.

    ``prior_map`` is that of a query that is not localized.
    """
    from ..doctor import map_finding, scan_findings

    scan = recording.scan(position)
    found = scan_findings([scan], config, posed=recording.poses is not None)
    if prior_map is None:
        found = [finding for finding in found if finding.wrong]
    elif not any(finding.wrong for finding in found):
        in_map = map_finding([scan], prior_map, config)
        found = [*([in_map] if in_map else []), *found]
    return [f"{'problem' if finding.wrong else 'note'}: {finding}" for finding in found]


def _show(trace: Trace, findings: list[str]) -> None:
    from ..inspect import confidence_tables, steps, summarize

    print(summarize(trace))
    for line in findings:
        print(line)
    print()
    for name, outcome in steps(trace):
        print(f"  {name:<10} {outcome}")
    tables = confidence_tables(trace)
    if tables:
        together = trace.prior + sum(part.log_odds for part in trace.parts)
        confidence = trace.result.confidence
        print(f"\nevidence, in log-odds: {together:+.1f} together, confidence {confidence:.2f}")
    for title, rows in tables:
        print(f"\n  {title}")
        for log_odds, label, words in rows:
            print(f"    {log_odds:>5}  {label:<13} {words}")
