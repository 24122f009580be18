"""``segloc view``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def view(
    prior_map: Annotated[Path, typer.Argument(metavar="MAP.segmap", help="The map.")],
    results: Annotated[
        Path | None,
        typer.Argument(
            metavar="RESULTS",
            help="A folder of `segloc localize --out` or `segloc live --out`.",
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
        int,
        typer.Option(min=0, max=65535, metavar="NUMBER", help="Port of the server, on localhost."),
    ] = 8080,
) -> None:
    """Show a map and the queries in it in the browser.

    Queries that `segloc localize --debug` kept are shown with their cloud on the map, segments,
    matches (those that agree are green), runner-up, and what the confidence is made of. The robot
    of `segloc live` is followed while it runs.
    """
    from ..inspect import viewer
    from ..inspect.following import follows, read_moments
    from ..inspect.results import read_results
    from ..map.segment_map import SegmentMap
    from ..system.files import checked_target, write_text
    from .console import busy, note

    if html is not None:
        checked_target(html)
    with busy("Loading"):
        prior = SegmentMap.load(prior_map)
        robot = results is not None and follows(results)
        queries = [] if results is None or robot else read_results(results)
    if queries and not any(query.stages for query in queries):
        note("only where queries were localized is known: `segloc localize --debug` keeps more")
    if html is not None:
        with busy("Writing the page"):
            page = (
                viewer.html_of_robot(prior, read_moments(results))
                if robot and results is not None
                else viewer.html(prior, queries)
            )
            write_text(html, page)
        print(f"{html} opens in a browser, from disk ({len(page) / 1e6:.1f} MB)")
        return
    if robot and results is not None:
        server = viewer.follow(prior, results, port)
    else:
        server = viewer.serve(prior, queries, port)
    print(f"http://localhost:{server.get_port()} shows {prior_map}; Ctrl-C ends it", flush=True)
    server.sleep_forever()
