"""Training datasets and tables of segment pairs from aligned sessions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from segloc import Config
from segloc.system.files import replacing
from segloc.types import Float64, Int64, Recording

from .collect import Posed, collect_recordings
from .dataset import FAR_M, SegmentDataset
from .extract import ExtractConfig
from .labels import LabelCounts, pairs_of
from .shards import Session, finish, load_dataset

MAX_PAIRS = 200_000
_COLUMNS = ("first", "second", "distance_m", "first_session", "second_session", "match")


def write_dataset(
    folder: Path,
    recordings: Sequence[Recording],
    place: str,
    config: Config,
    progress: Callable[[str], None] = lambda text: None,
) -> LabelCounts:
    """Cut aligned recordings of one place into labelled segments for ``segloc train``.

    The poses are used as they are, without registration.

    Parameters
    ----------
    recordings : sequence of Recording
        With poses in one frame.
    place : str
        Name of the place.
    config : Config
        Sensor and segmentation.
    progress : callable, optional
        Called with one line per session.
    """
    settings = ExtractConfig(local_cloud=config.local_cloud)
    items = [
        Posed(Session(place, f"{k:02d}-{recording.name}", "unknown"), recording)
        for k, recording in enumerate(recordings)
    ]
    sessions = collect_recordings(
        folder, items, settings, config.segmentation, register=False, progress=progress
    )
    return finish(folder, sessions, settings.label)


def write_pairs(path: Path, dataset_folder: Path, seed: int = 0) -> int:
    """Write pairs of segments of a dataset, as many matching as different ones.

    ``first`` and ``second`` are rows of the dataset as ``load_dataset`` returns it. Matching pairs
    show one object (centroids within 0.5 m, by the labels) and are thinned evenly beyond 200 000;
    different ones are drawn at random among pairs more than 20 m apart.
    Returns
    -------
    int
        Number of matching pairs.
    """
    dataset = load_dataset(dataset_folder)
    matching = pairs_of(dataset.labels, MAX_PAIRS)
    different = _different(dataset, len(matching[0]), np.random.default_rng(seed))
    lines = [*_rows(dataset, *matching, 1), *_rows(dataset, *different, 0)]
    with replacing(path) as stream:
        text = "".join(",".join(line) + "\n" for line in [list(_COLUMNS), *lines])
        stream.write(text.encode())
    return len(matching[0])


def _different(
    dataset: SegmentDataset, count: int, rng: np.random.Generator
) -> tuple[Int64, Int64]:
    """Draw random pairs of one place more than 20 m apart."""
    first = rng.integers(len(dataset), size=4 * count)
    second = rng.integers(len(dataset), size=4 * count)
    far = _distances(dataset.centroids, first, second) > FAR_M
    far &= dataset.places[first] == dataset.places[second]
    return first[far][:count], second[far][:count]


def _distances(centroids: Float64, first: Int64, second: Int64) -> Float64:
    return np.linalg.norm(centroids[first] - centroids[second], axis=1)


def _rows(dataset: SegmentDataset, first: Int64, second: Int64, match: int) -> list[list[str]]:
    distances = _distances(dataset.centroids, first, second)
    sessions = dataset.sessions[first], dataset.sessions[second]
    columns = zip(first, second, distances, *sessions, strict=True)
    return [[str(a), str(b), f"{d:.3f}", str(s), str(t), str(match)] for a, b, d, s, t in columns]
