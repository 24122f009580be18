"""ROC curves of methods trained on one domain and tested on another."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from segloc.descriptors.base import Descriptor
from segloc.errors import ConfigError, WeightsError
from segloc.types import Float64

from ...evaluation.comparison import METHODS
from ...evaluation.comparison import fingerprint as shipped_fingerprint
from ...evaluation.workspace import mute, silent
from ...training.shards import INDEX
from .domains import RECORDED, SIZES, Domains, DomainSize
from .learning import (
    EFFORTS,
    FORESTS,
    NETWORKS,
    Effort,
    Training,
    load_method,
    source_of,
    trained,
)
from .pairs import Described, Pairs, Roc, described, labelled_pairs, pair_scores, roc, trust_scores
from .workspace import Workspace

SHIPPED = "shipped"
"""The shipped weights, as if they were a training domain."""

TITLES = {
    "kitti": "KITTI (simulated)",
    "burgess": "Burgess Field (simulated)",
    "robotcar": "RobotCar (simulated)",
    RECORDED: "KITTI 00 (real)",
    SHIPPED: "shipped weights",
}
"""Training and test sets."""


@dataclass(frozen=True)
class Plan:
    """Amounts of simulation, training and comparison.

    Attributes
    ----------
    sizes : dict of str to DomainSize
        By simulated domain.
    effort : Effort
        Of each training.
    pairs : int
        Of each kind, of a test set at most.
    """

    sizes: Mapping[str, DomainSize]
    effort: Effort
    pairs: int


PLANS = {
    "small": Plan(SIZES["small"], EFFORTS["small"], 4_000),
    "full": Plan(SIZES["full"], EFFORTS["full"], 10_000),
}
"""By scale."""


class Transfer:
    """ROC curves of any method, training and test domain; each is computed once.

    Parameters
    ----------
    plan : Plan, optional
        By default that of the workspace's scale.

    Attributes
    ----------
    methods : tuple of str
        Those of :data:`~segloc_lab.evaluation.comparison.METHODS` that the workspace names.
    fingerprints : dict of str to str
        Of all weights used so far, by method and training set.
    """

    def __init__(self, workspace: Workspace, plan: Plan | None = None) -> None:
        self.workspace = workspace
        self.plan = plan or PLANS[workspace.effort]
        self.domains = Domains(workspace, self.plan.sizes)
        self.methods = tuple(m for m in METHODS if m in (workspace.methods or METHODS))
        if not self.methods:
            raise ConfigError(f"no method to compare; there are {', '.join(METHODS)}")
        self.fingerprints: dict[str, str] = {}
        self._pairs: dict[str, Pairs] = {}
        self._described: dict[tuple[str, str], Described] = {}

    def prepare(self, domains: Sequence[str]) -> None:
        """Make the segments of some domains, and train all methods on each, in parallel."""
        for domain in domains:
            self.domains.folder(domain, "test")
        wanted = [
            self._training(method, domain)
            for domain in domains
            for method in dict.fromkeys(map(source_of, self.methods))
            if method in (*NETWORKS, *FORESTS)
        ]
        trained(self.workspace, wanted)

    def curves(
        self, cells: Sequence[tuple[str, str]], trusted: Sequence[str] = ()
    ) -> dict[tuple[str, str], dict[str, Roc]]:
        """Return the curves of all methods of each (source, test), made in parallel.

        :meth:`trust` of the ``trusted`` methods is made and kept with them.
        """
        space = self.workspace
        if space.workers > 1 or space.executor is not None:
            alone = replace(space, progress=silent, say=mute, workers=1, executor=None)
            work = partial(_score, alone, self.plan, tuple(trusted))
            list(space.each("Scoring pairs", work, cells))
        curves = {}
        with space.progress("Adding up") as update:
            for done, cell in enumerate(cells):
                update(done, len(cells))
                found = {method: self.curve(method, *cell) for method in self.methods}
                curves[cell] = {m: curve for m, curve in found.items() if curve is not None}
        return curves

    def curve(self, method: str, source: str, test: str) -> Roc | None:
        """Return the ROC of a method trained on ``source`` on the pairs of ``test``.

        None where there is nothing to tell: weights that are not shipped.
        """

        def scores(descriptor: Descriptor) -> Float64:
            return pair_scores(self._describe(descriptor, test), descriptor.pruner)

        return self._cached("roc", method, source, test, scores)

    def trust(self, method: str, source: str, test: str) -> Roc | None:
        """Return the same for the order of candidate matches; None without a quality."""

        def scores(descriptor: Descriptor) -> Float64 | None:
            return trust_scores(self._describe(descriptor, test))

        return self._cached("trust", method, source, test, scores)

    def pairs(self, test: str) -> Pairs:
        """Return the labelled pairs of a test set."""
        if test not in self._pairs:
            dataset = self.domains.dataset(test, "test")
            self._pairs[test] = labelled_pairs(
                dataset, limit=self.plan.pairs, seed=self.workspace.seed
            )
        return self._pairs[test]

    def _training(self, method: str, domain: str) -> Training:
        return Training(
            method,
            self.domains.folder(domain, "train"),
            self.plan.effort.config(method, self.workspace.seed),
            self.workspace.out / "models",
        )

    def _weights(self, method: str, source: str) -> Path | None:
        """Return a method's training; None if shipped or untrained."""
        base = source_of(method)
        if source == SHIPPED or base not in (*NETWORKS, *FORESTS):
            return None
        return trained(self.workspace, [self._training(base, source)])[0]

    def _cached(
        self,
        kind: str,
        method: str,
        source: str,
        test: str,
        scores: Callable[[Descriptor], Float64 | None],
    ) -> Roc | None:
        weights = self._weights(method, source)
        try:
            descriptor = load_method(method, weights)
        except WeightsError:
            if weights is None:
                return None  # nothing of that name is shipped
            raise
        own = _fingerprint(descriptor, method, weights)
        self.fingerprints[f"{method}, {source}"] = own
        index = self.domains.folder(test, "test") / INDEX
        settings = {
            "weights": own,
            "data": [index.parent.name, hashlib.sha256(index.read_bytes()).hexdigest()],
            "pairs": self.plan.pairs,
            "seed": self.workspace.seed,
        }

        def compute() -> Roc | None:
            found = scores(descriptor)
            if found is None:
                return None
            return roc(found, self.pairs(test), seed=self.workspace.seed)

        def save(curve: Roc | None, path: Path) -> None:
            if curve is None:
                path.touch()
            else:
                curve.save(path)

        def load(path: Path) -> Roc | None:
            return Roc.load(path) if path.stat().st_size else None

        name = f"{kind}-{method}-{source}-{test}"
        return self.workspace.cached(name, settings, compute, save, load)

    def _describe(self, descriptor: Descriptor, test: str) -> Described:
        key = descriptor.fingerprint, test
        if key not in self._described:
            dataset = self.domains.dataset(test, "test")
            self._described[key] = described(descriptor, dataset, self.pairs(test))
        return self._described[key]


def _score(workspace: Workspace, plan: Plan, trusted: Sequence[str], cell: tuple[str, str]) -> None:
    """Compute the curves of all methods for one (source, test), in any process."""
    transfer = Transfer(workspace, plan)
    for method in transfer.methods:
        transfer.curve(method, *cell)
    for method in trusted:
        transfer.trust(method, *cell)


def _fingerprint(descriptor: Descriptor, method: str, weights: Path | None) -> str:
    """Return a hash of everything that affects a method's scores."""
    if weights is None:
        return shipped_fingerprint(method)
    pruner = descriptor.pruner.fingerprint if descriptor.pruner is not None else ""
    digest = hashlib.sha256(f"{descriptor.fingerprint} {pruner}".encode() + weights.read_bytes())
    return digest.hexdigest()[:16]
