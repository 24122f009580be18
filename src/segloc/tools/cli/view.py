"""``segloc view``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import busy, note

if TYPE_CHECKING:
    from ...map.segment_map import SegmentMap


def view(
    prior_map: Annotated[Path, typer.Argument(metavar="MAP.segmap", help="The map.")],
    results: Annotated[
        Path | None,
        typer.Argument(
            metavar="RESULTS",
            help="Results folder of `segloc localize` or `segloc live`.",
            show_default="none",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write one self-contained page instead of serving.",
            show_default="none: a server",
        ),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            metavar="NUMBER",
            help="Port of the server, on localhost.",
            show_default="8080, or the next free one",
        ),
    ] = None,
) -> None:
    """Show a map and the queries in it in the browser.

    Queries stored by `segloc localize --debug` are shown with their cloud on the map, segments,
    matches (inliers are green), runner-up, and evidence. The robot of `segloc live`
    is followed during a run.
    """
    from ...map.segment_map import SegmentMap
    from ...system.files import checked_target, write_text
    from ..inspect import viewer
    from ..inspect.following import SO_FAR, follows, read_moments
    from ..inspect.results import read_results

    if html is not None:
        checked_target(html, ".html", ".htm")
    with busy("Loading"):
        prior = SegmentMap.load(prior_map)
        robot = results if results is not None and follows(results) else None
        queries = [] if results is None or robot is not None else read_results(results)
    if queries and not any(query.stages for query in queries):
        note("only positions of queries are stored: `segloc localize --debug` stores their stages")
    if results is not None and not (results / SO_FAR).is_file():  # else the summary is an old one
        _check_map(results, prior_map, prior)
    if html is not None:
        with busy("Writing the page"):
            if robot is None:
                page = viewer.html(prior, queries)
            else:
                page = viewer.html_of_robot(prior, read_moments(robot))
            write_text(html, page)
        print(f"{html}: open it in a browser, no server needed ({len(page) / 1e6:.1f} MB)")
        return
    if robot is None:
        server = viewer.serve(prior, queries, port)
    else:
        server = viewer.follow(prior, robot, port)
    print(f"http://localhost:{server.get_port()} shows {prior_map}; Ctrl-C stops it", flush=True)
    server.sleep_forever()


def _check_map(results: Path, path: Path, prior_map: SegmentMap) -> None:
    """Note if results were localized in another map."""
    from ...map.identity import map_id
    from ..inspect.results import stored_map_id

    if stored_map_id(results) not in (None, map_id(prior_map)):
        note(
            f"{results}: localized in another map than {path}, or in another version of it: poses "
            "may not fit; view them in the map in which they were localized"
        )
