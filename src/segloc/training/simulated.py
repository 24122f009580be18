"""Labelled segments of simulated worlds, without recordings on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass

from ..segmentation import Segmenter
from ..simulation import SCENES, SENSORS, Conditions, simulate_sessions
from ..types import LocalCloud, Segments
from .dataset import SegmentDataset
from .extract import ExtractConfig, extract


@dataclass(frozen=True)
class SimulatedPlace:
    """Sessions of one world that segments are taken from.

    Attributes
    ----------
    scene : str
        Of :data:`segloc.simulation.SCENES`.
    seed : int
        Of world, routes and noise.
    sensor : str
        Of :data:`segloc.simulation.SENSORS`.
    thin : int
        Only every so many-th firing.
    conditions : tuple of Conditions
        Of each session.
    length_m, spacing_m : float
        Of each drive, and between its scans.
    size_m : float or None
        Of the world; None for the scene's default.
    """

    scene: str
    seed: int
    sensor: str = "hdl64e"
    thin: int = 2
    conditions: tuple[Conditions, ...] = (Conditions(), Conditions(foliage=0.7, replaced=0.15))
    length_m: float = 300.0
    spacing_m: float = 2.0
    size_m: float | None = None

    def segments(
        self,
        segment: Callable[[LocalCloud], Segments] | None = None,
        config: ExtractConfig | None = None,
    ) -> SegmentDataset:
        """Simulate, gather, segment and label; the same for the same place, wherever it is run.

        Raises
        ------
        ConfigError
            If the world or a drive is impossible.
        DatasetError
            If no segment was found.
        MissingDependency
            If embreex is not installed.
        """
        make = SCENES[self.scene]
        world = make(self.seed) if self.size_m is None else make(self.seed, size_m=self.size_m)
        drives = simulate_sessions(
            world,
            SENSORS[self.sensor]().thinned(self.thin),
            list(self.conditions),
            length_m=self.length_m,
            spacing_m=self.spacing_m,
            seed=self.seed,
        )
        return extract(drives, segment or segmented, config)


def segmented(cloud: LocalCloud) -> Segments:
    """The segments of a cloud with the default settings."""
    return Segmenter().segment(cloud).segments


def simulated_segments(
    places: Iterable[SimulatedPlace],
    segment: Callable[[LocalCloud], Segments] | None = None,
    config: ExtractConfig | None = None,
    *,
    executor: Executor | None = None,
) -> Iterator[SegmentDataset]:
    """One dataset for each place, in their order; :meth:`SegmentDataset.concatenate` joins them.

    Parameters
    ----------
    places : iterable of SimulatedPlace
    segment : callable, optional
        Divides a local cloud into segments; by default the shipped segmentation.
    config : ExtractConfig, optional
    executor : Executor, optional
        Where to simulate, a place at a time in each worker; by default here, one after another. A
        process pool must start fresh processes, as :func:`segloc.simulation.process_pool` does.
    """
    if executor is None:
        for place in places:
            yield place.segments(segment, config)
        return
    futures = [executor.submit(place.segments, segment, config) for place in places]
    for future in futures:
        yield future.result()
