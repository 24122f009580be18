"""``segloc train extract``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from segloc.cli.console import say
from segloc.cli.options import Cluster, ConfigFile, PosesOfEach, SelectOfEach, Topic, each

if TYPE_CHECKING:
    from ..training.extract import ExtractConfig
    from ..training.labels import LabelCounts
    from ..training.shards import Session

Out = Annotated[Path, typer.Option("--out", metavar="DATASET", help="Folder of the dataset.")]
Lengths = Annotated[
    list[float] | None,
    typer.Option(
        "--length",
        metavar="METRES",
        help="Path length of a local cloud; 0: single scans.",
        show_default="40, 16 and 0",
    ),
]

Thin = Annotated[
    int, typer.Option(min=1, metavar="COUNT", help="Keep every COUNT-th simulated firing.")
]
Workers = Annotated[
    int,
    typer.Option(
        min=1, metavar="COUNT", help="Processes; recordings need --no-register for several."
    ),
]

Sequences = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="SEQUENCE",
        help="Recordings of one place, one per session.",
        show_default="none: --simulate",
    ),
]

Simulate = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE:N,...",
        help="Simulate worlds instead of reading recordings.",
        show_default="none",
    ),
]

Sensors = Annotated[
    str | None,
    typer.Option(
        metavar="NAME,...",
        help="Simulated sensors to choose from.",
        show_default="the usual ones",
    ),
]


def extract(
    out: Out,
    sequences: Sequences = None,
    poses: PosesOfEach = None,
    select: SelectOfEach = None,
    topic: Topic = None,
    place: Annotated[str, typer.Option(metavar="NAME", help="Name of the place.")] = "place",
    sensor: Annotated[str, typer.Option(metavar="NAME", help="Sensor name.")] = "unknown",
    register: Annotated[bool, typer.Option(help="Align each session with those before it.")] = True,
    simulate: Simulate = None,
    sensors: Sensors = None,
    thin: Thin = 1,
    drive: Annotated[
        float, typer.Option(metavar="METRES", help="Length of a simulated drive.")
    ] = 500.0,
    length: Lengths = None,
    every: Annotated[
        float, typer.Option(metavar="METRES", help="Distance between local clouds.")
    ] = 10.0,
    centroids_only: Annotated[
        bool, typer.Option(help="Label by centroids alone, as the paper does.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Random seed.")] = 0,
    workers: Workers = 2,
    cluster: Cluster = None,
    config: ConfigFile = None,
) -> None:
    """Cut recordings or simulated worlds into labelled segments.

    The sequences of one call are sessions of one place and share a frame; calls add up. What is
    finished stays: a call that was cut off goes on when it is given again.
    """
    from segloc.cli.console import note
    from segloc.config import validated
    from segloc.errors import ConfigError

    from ..training.extract import ExtractConfig
    from ..training.shards import finish

    if bool(sequences) == (simulate is not None):
        raise ConfigError("name recordings, or worlds to --simulate, and not both")
    lengths = tuple(length) if length else ExtractConfig().lengths_m
    rule = {"rule": "centroids" if centroids_only else "extents"}
    values = {"lengths_m": lengths, "every_m": every, "seed": seed, "label": rule}
    settings = validated(ExtractConfig, values, "extraction")
    if simulate is not None:
        chosen = tuple(sensors.split(",")) if sensors else ()
        drawn = {"length_m": drive, "sensors": chosen, "thin": thin}
        done = _simulate(out.absolute(), simulate, drawn, settings, workers, cluster, config)
    else:
        named = _Recordings(sequences or [], poses or [], select or [], topic, place, sensor)
        alone = register or len(named.rows) == 1  # each is aligned with those before it
        means = (1 if alone else workers, cluster)
        done = named.collect(out.absolute(), settings, register, config, *means)
    if not done:
        note("nothing was extracted")
        return
    _show(finish(out, done, settings.label), str(out))


def _simulate(
    out: Path,
    simulate: str,
    drawn: dict[str, Any],
    settings: ExtractConfig,
    workers: int,
    cluster: str | None,
    config: Path | None,
) -> list[Session]:
    from segloc.cli.options import load_config
    from segloc.system.processes import executing

    from ..training.collect import collect_worlds
    from ..training.worlds import draw_worlds

    worlds = draw_worlds(simulate, settings.seed, **drawn)

    segmentation = load_config(config, None, 1).segmentation
    with executing(1, cluster) as executor:
        return collect_worlds(
            out, worlds, settings, segmentation, workers=workers, progress=say, executor=executor
        )


class _Recordings:
    """The recordings that a command line names."""

    def __init__(
        self,
        sequences: list[Path],
        poses: list[Path],
        select: list[str],
        topic: str | None,
        place: str,
        sensor: str,
    ) -> None:
        from segloc.errors import ConfigError

        if "--" in place or "/" in place or not place:
            raise ConfigError(f"{place!r} cannot be the name of a place")
        count = len(sequences)
        self.rows = list(
            zip(
                sequences,
                each(poses, count, "--poses"),
                each(select, count, "--select"),
                strict=True,
            )
        )
        self.topic, self.place, self.sensor = topic, place, sensor

    def collect(
        self,
        out: Path,
        settings: ExtractConfig,
        register: bool,
        config: Path | None,
        workers: int,
        cluster: str | None,
    ) -> list[Session]:
        from segloc.cli.options import load_config
        from segloc.cli.recording import open_recording
        from segloc.system.processes import executing

        from ..training.collect import Posed, collect_recordings
        from ..training.shards import Session

        items = [
            Posed(
                Session(self.place, f"{k:02d}-{path.resolve().name}", self.sensor),
                open_recording(path, poses, select, topic=self.topic),
            )
            for k, (path, poses, select) in enumerate(self.rows)
        ]
        segmentation = load_config(config, None, 1).segmentation
        with executing(workers, cluster) as executor:
            return collect_recordings(
                out,
                items,
                settings,
                segmentation,
                register=register,
                progress=say,
                executor=executor,
            )


def _show(counts: LabelCounts, title: str) -> None:
    from segloc.cli.console import number, table

    rows = [
        ("segments", f"{counts.segments:,}"),
        ("objects", f"{counts.objects:,}"),
        ("objects with several views", f"{counts.seen_again:,}"),
        ("views of each of those", number(counts.views)),
        ("matching pairs", f"{counts.matching:,}"),
        ("matching pairs across sessions", f"{counts.matching_across:,}"),
        ("pairs that differ", f"{counts.different:,}"),
    ]
    if counts.agreeing == counts.agreeing:
        rows.append(("of the pairs across, truly one object", f"{100 * counts.agreeing:.1f} %"))
    table(title, ("", ""), rows)
