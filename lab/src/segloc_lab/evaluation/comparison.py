"""Localize the queries of a scenario by several methods; each cloud is segmented once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from segloc import SegmentMap
from segloc.config import Config
from segloc.descriptors import Descriptor, available, create
from segloc.errors import ConfigError, DatasetError, WeightsError
from segloc.frontend import Segmenter
from segloc.localization import Localization, Localized, NotLocalized, Reason
from segloc.localizer import Localizer
from segloc.map import DEFAULT_METHOD, add_view, empty_map, map_views
from segloc.proposals import Estimator, PoseEstimator, Query
from segloc.tools.batch import Evaluation, query_clouds
from segloc.types import Descriptors, Float64, Recording, Segments

from .scenario import QuerySet

METHODS = (
    "segmatch-eigen",
    "segmatch-esf",
    "nsm",
    "segmap",
    "esm",
    "esm-fq",
    "dsm",
    "dsm-fq",
    "geo",
    "profile",
)
"""Methods of the paper by year, then ours."""


def published_estimator(method: str) -> str:
    """Return ``pose.estimator`` of a method's publication."""
    return "geometric_consistency" if method.startswith("segmatch-") else "prosac"


@dataclass(frozen=True)
class Methods:
    """Methods to compare.

    Attributes
    ----------
    fingerprints : dict of str to str
        Of descriptor, weights, and forest or FC4, by the name of each available method.
    left_out : dict of str to str
        Why the other methods are missing.
    """

    fingerprints: dict[str, str]
    left_out: dict[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the available methods."""
        return tuple(self.fingerprints)

    def note(self) -> str:
        """Describe the missing methods in one sentence; "" if there are none."""
        if not self.left_out:
            return ""
        parts = "; ".join(f"{name} ({why})" for name, why in self.left_out.items())
        return f"Left out: {parts}."


def ready(names: tuple[str, ...] | None = None) -> Methods:
    """Return which methods (by default :data:`METHODS`) have their weights."""
    chosen = METHODS if names is None else names
    for name in chosen:
        if name not in available():
            raise ConfigError(f"no method {name!r}; available: {', '.join(available())}")
    fingerprints, left_out = {}, {}
    for name in dict.fromkeys(chosen):
        try:
            fingerprints[name] = fingerprint(name)
        except WeightsError as error:
            left_out[name] = str(error)
    if not fingerprints:
        raise ConfigError(f"no weights for {', '.join(chosen)}")
    return Methods(fingerprints, left_out)


def best_of(methods: Methods) -> str:
    """Return our method if it is included, else the last."""
    return DEFAULT_METHOD if DEFAULT_METHOD in methods.names else methods.names[-1]


def fingerprint(name: str) -> str:
    """Return a hash of everything that affects a method's results."""
    descriptor = create(name, 1)
    if descriptor.pruner is None:
        return descriptor.fingerprint
    return f"{descriptor.fingerprint}+{descriptor.pruner.fingerprint}"


ESTIMATORS = ("consensus", "published")
"""Our estimator, and the one published with each method."""

QUALITY = "-fq"
"""Suffix of methods whose matches are ordered by FC4, the feature quality."""

_CELL_M, _TALL_M = 0.5, 1.0

Answer = dict[str, Any]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class MappedPlace:
    """Maps of one place by every method, with one cloud.

    Attributes
    ----------
    trajectory : (V, 4, 4) float64
    cloud : (N, 3) float64
        Map frame.
    """

    localizers: Mapping[str, Mapping[str, Localizer]]
    trajectory: Float64
    cloud: Float64


def shared_config(method: str, threads: int, segments_alone: bool = False) -> Config:
    """Return a method's preset with the default segmentation, shared by all methods.

    With ``segments_alone`` there are no other proposers.
    """
    preset, default = Config.preset(method), Config()
    shared = {name: getattr(default, name) for name in ("local_cloud", "segmentation", "mapping")}
    if segments_alone:
        shared["occupancy"] = preset.occupancy.model_copy(update={"enabled": False})
    return preset.model_copy(update={**shared, "threads": threads})


def build_maps(
    recording: Recording, descriptors: Mapping[str, Descriptor], threads: int = 1
) -> dict[str, SegmentMap]:
    """Build the maps of several methods from the same segments; the first holds the cloud."""
    config = Config(threads=threads)
    poses = recording.poses
    if poses is None or len(poses) == 0:
        raise DatasetError(f"{recording.name}: building a map needs a pose for every scan")
    first = next(iter(descriptors))
    maps = {name: empty_map(each, config, poses[0, :3, 3]) for name, each in descriptors.items()}
    for view in map_views(recording, config):
        described = describe_all(descriptors, view.scene.segments)
        for name in descriptors:
            add_view(maps[name], view, described[name], with_cloud=name == first)
    if not len(maps[first]):
        raise DatasetError(f"{recording.name}: no segments found in {len(recording)} scans")
    for prior_map in maps.values():
        prior_map.add_trajectory(poses)
    return maps


def describe_all(
    descriptors: Mapping[str, Descriptor], segments: Segments
) -> dict[str, Descriptors]:
    """Describe segments by every method; methods with the same network run it once."""
    found: dict[str, Descriptors] = {}
    once: dict[str, Descriptors] = {}
    for name, descriptor in sorted(descriptors.items(), key=lambda item: not item[1].rates):
        same = once.get(descriptor.fingerprint)
        if same is None:
            found[name] = once[descriptor.fingerprint] = descriptor.describe(segments)
        else:
            found[name] = same if descriptor.rates else Descriptors(same.vectors)
    return found


def place_of(
    maps: Mapping[str, SegmentMap], threads: int = 1, segments_alone: bool = False
) -> MappedPlace:
    """Prepare maps of one place by several methods; the first holds the cloud."""
    bases = {
        name: Localizer(prior_map, shared_config(name, threads, segments_alone))
        for name, prior_map in maps.items()
    }
    first = next(iter(bases.values()))
    localizers = {name: _localizers(base, first) for name, base in bases.items()}
    return MappedPlace(
        localizers, first.prior_map.trajectory, first.prior_map.cloud + first.prior_map.origin
    )


def with_map_cloud(
    first: Localizer, other: Localizer, estimator: Estimator | None = None
) -> Localizer:
    """Return a localizer in another map with the cloud of ``first`` and its prepared data."""
    return Localizer(
        other.prior_map,
        other.config,
        estimator=estimator or other.estimator,
        proposers=first.proposers,
        likelihood=first.likelihood,
    )


def _localizers(base: Localizer, first: Localizer) -> dict[str, Localizer]:
    config = base.config
    found = {}
    for name in ESTIMATORS:
        chosen = published_estimator(config.method) if name == "published" else name
        pose = config.pose.model_copy(update={"estimator": chosen})
        estimator = PoseEstimator(pose, threads=config.threads, seed=config.seed)
        found[name] = with_map_cloud(first, base, estimator)
    return found


def localize_all(
    query_sets: Mapping[str, QuerySet],
    descriptors: Mapping[str, Descriptor],
    places: Mapping[str, MappedPlace],
) -> dict[str, Any]:
    """Localize every query in every place, by every method.

    Returns
    -------
    dict
        ``answers[method][query_set][place][estimator]`` is a list of one dict per query, in JSON
        values.
    """
    answers: dict[str, Any] = {
        method: {
            query_set: {place: {name: [] for name in ESTIMATORS} for place in places}
            for query_set in query_sets
        }
        for method in descriptors
    }
    for name, query_set in query_sets.items():
        for found in localized(query_set, descriptors, places):
            for (method, place, estimator), result in found.items():
                answers[method][name][place][estimator].append(_record(result))
    return answers


def localized(
    query_set: QuerySet,
    descriptors: Mapping[str, Descriptor],
    places: Mapping[str, MappedPlace],
    estimators: Sequence[str] = ESTIMATORS,
) -> Iterator[dict[tuple[str, str, str], Localization]]:
    """Yield the results of each query by (method, place, estimator).

    A cloud is accumulated and segmented once, and described once by each method.
    """
    config = Config()
    segmenter = Segmenter(config.segmentation)
    for cloud, _ in query_clouds(query_set.recording, query_set.positions, config):
        scene = segmenter.segment(cloud)
        yield {
            (method, place, estimator): mapped.localizers[method][estimator].locate(
                Query(cloud, scene, described)
            )
            for method, described in describe_all(descriptors, scene.segments).items()
            for place, mapped in places.items()
            for estimator in estimators
        }


def _record(result: Localization) -> Answer:
    pose = result.T_map_sensor
    return {
        "reason": None if result.reason is None else result.reason.value,
        "message": result.message,
        "T_map_sensor": None if pose is None else pose.ravel().tolist(),
        "inliers": result.inliers,
        "overlap": result.overlap,
        "confidence": result.confidence,
    }


def _localization(answer: Answer) -> Localization:
    """Restore the output of :func:`_record`."""
    figures = {name: answer[name] for name in ("inliers", "overlap", "confidence")}
    if answer["T_map_sensor"] is None:
        reason = Reason(answer["reason"])
        return NotLocalized(reason=reason, message=answer["message"], **figures)
    return Localized(T_map_sensor=np.array(answer["T_map_sensor"]).reshape(4, 4), **figures)


def arrays_of(
    query_sets: Mapping[str, QuerySet], trajectory: Float64, cloud: Float64
) -> dict[str, Float64]:
    """Return the data of queries and a :class:`MappedPlace` for tables and pictures.

    "trajectory" (V, 2), above-ground "cloud" (N, 2), and for each set of queries "indices-SET" and,
    if known, "truths-SET".
    """
    arrays = {"trajectory": trajectory[:, :2, 3], "cloud": standing(cloud)}
    for name, query_set in query_sets.items():
        arrays[f"indices-{name}"] = query_set.recording.indices[query_set.positions].astype(
            np.float64
        )
        if query_set.truths is not None:
            arrays[f"truths-{name}"] = query_set.truths
    return arrays


def standing(cloud: Float64) -> Float64:
    """Return above-ground cells (N, 2): their points differ in height by at least a metre."""
    if not len(cloud):
        return np.empty((0, 2))
    cells, group = np.unique(np.round(cloud[:, :2] / _CELL_M), axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    starts = np.flatnonzero(np.diff(group.ravel()[order], prepend=-1))
    z = cloud[order, 2]
    tall = np.maximum.reduceat(z, starts) - np.minimum.reduceat(z, starts) >= _TALL_M
    found: Float64 = cells[tall] * _CELL_M
    return found


def evaluation(answers: list[Answer], arrays: Mapping[str, Float64], query_set: str) -> Evaluation:
    """Score the results of one set of queries against the truth, if known."""
    results = [_localization(answer) for answer in answers]
    path = np.tile(np.eye(4), (len(arrays["trajectory"]), 1, 1))
    path[:, :2, 3] = arrays["trajectory"]
    indices = arrays[f"indices-{query_set}"].astype(np.int64)
    return Evaluation(indices, results, path, arrays.get(f"truths-{query_set}"))
