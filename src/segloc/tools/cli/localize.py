"""``segloc localize``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...errors import ConfigError, SeglocError
from . import options
from .console import busy, note, progress

if TYPE_CHECKING:
    from ...types import Recording


def localize(
    sequence: options.Recording,
    prior_map: Annotated[
        str,
        typer.Option(
            "--map", metavar="MAP", help="The prior map: a file, or a folder or URL of tiles."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Output folder.", show_default="none: results are printed"
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Also write a page with pictures to pass on.", show_default="none"
        ),
    ] = None,
    debug: Annotated[
        bool, typer.Option("--debug", help="Also store the stages of each query for `segloc view`.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
    poses: options.Poses = None,
    select: options.Select = None,
    every: options.Every = None,
    truth: options.Truth = None,
    tolerance_m: options.Metres = 3.0,
    tolerance_deg: options.Degrees = 5.0,
    near: options.Near = None,
    height: options.Height = None,
    radius: options.Radius = None,
    anywhere: options.Anywhere = False,
    gnss: options.Gnss = False,
    topic: options.Topic = None,
    deskew: options.Deskew = True,
    odometry: options.Odometry = False,
    level: options.Level = False,
    config: options.ConfigFile = None,
    weights: options.SameWeights = None,
    threads: options.Threads = 0,
    workers: options.Workers = 1,
    cluster: options.Cluster = None,
) -> None:
    """Find the pose of a scan, or of each scan of a recording, in a map; no initial guess.

    With poses, a query is a cloud accumulated over the path behind it; otherwise one scan. Prints
    the pose and its confidence, or the reason why the query is not localized.
    """
    from ...system.files import checked_target
    from ...system.processes import executing
    from ...tiles import open_map
    from ..batch.score import Evaluation, Tolerance
    from .queries import Queries, gnss_priors, localize_in_detail, query_positions, show_results
    from .recording import levelled_poses, open_recording, place_of_sensor, true_poses

    options.check_every(every)
    if (radius is not None or anywhere) and near is None and height is None and not gnss:
        raise ConfigError("--radius and --anywhere need --near, --height or --gnss")
    radius = options.RADIUS_M if radius is None else radius
    place = options.parsed_prior(near, radius, anywhere, height)
    if html is not None:
        checked_target(html, ".html", ".htm")
    _check_out(out, debug, alone=workers == 1 and cluster is None)
    with busy("Loading the map"):
        localizer = options.open_localizer(open_map(prior_map), config, threads, weights)
    prior, local = localizer.prior_map, localizer.config.local_cloud
    sequence = sequence.absolute() if cluster else sequence
    recording: Recording = open_recording(
        sequence, poses, select, topic=topic, deskew=deskew, odometry=odometry, local=local
    )
    recording = levelled_poses(recording, local, level)
    truths = true_poses(recording, sequence, truth, topic, place_of_sensor(local.mount))
    positions = query_positions(recording, truths, every, local.max_gap_m)
    priors = gnss_priors(prior, recording, positions, sequence, place, radius) if gnss else place
    queries = Queries(localizer, prior_map, recording, positions, priors)
    kept: dict[str, bytes] = {}
    fault: SeglocError | None = None
    with progress("Localizing") as update, executing(workers, cluster) as executor:
        if debug:
            results, kept, fault = localize_in_detail(queries, update)
        else:
            results, fault = queries.localize(executor, update)
    if fault is not None:
        queries = queries.first(len(results))
        note(f"{len(results)} of {len(positions)} queries come before a scan that cannot be read")
    positions = queries.positions
    known = None if truths is None else truths[positions]
    tolerance = Tolerance(tolerance_m, tolerance_deg)
    indices = recording.indices[positions]
    evaluation = Evaluation(indices, results, prior, known, tolerance)
    show_results(queries, evaluation, options.map_name(prior_map), out, html, kept, json)
    if fault is not None:
        raise fault


def _check_out(out: Path | None, debug: bool, alone: bool) -> None:
    from .results import check_folder

    if out is not None:
        check_folder(out)
    elif debug:
        raise ConfigError("--debug needs --out DIR, to store the stages of each query")
    if debug and not alone:
        raise ConfigError("--debug works in one process only: omit --workers and --cluster")
