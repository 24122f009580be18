"""The methods that are compared, and which of them are ready to run."""

from __future__ import annotations

from dataclasses import dataclass

from segloc.descriptors import available, create
from segloc.errors import ConfigError, WeightsError
from segloc.map import DEFAULT_METHOD

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
"""Those of the paper by year, and ours."""


def published_estimator(method: str) -> str:
    """What a method of the paper recognises places by: ``pose.estimator`` of its publication."""
    return "geometric_consistency" if method.startswith("segmatch-") else "prosac"


@dataclass(frozen=True)
class Methods:
    """Methods to compare.

    Attributes
    ----------
    fingerprints : dict of str to str
        Of descriptor, weights, and forest or FC4, by the name of each method that is ready.
    left_out : dict of str to str
        Why the others are not.
    """

    fingerprints: dict[str, str]
    left_out: dict[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """Of those that are ready."""
        return tuple(self.fingerprints)

    def note(self) -> str:
        """The methods that are left out and why, in one sentence; empty if there are none."""
        if not self.left_out:
            return ""
        parts = "; ".join(f"{name} ({why})" for name, why in self.left_out.items())
        return f"Left out: {parts}."


def ready(names: tuple[str, ...] | None = None) -> Methods:
    """Which of the methods (:data:`METHODS` where none are named) have their weights."""
    chosen = METHODS if names is None else names
    for name in chosen:
        if name not in available():
            raise ConfigError(f"no method {name!r}; there are {', '.join(available())}")
    fingerprints, left_out = {}, {}
    for name in dict.fromkeys(chosen):
        try:
            fingerprints[name] = fingerprint(name)
        except WeightsError as error:
            left_out[name] = str(error)
    if not fingerprints:
        raise ConfigError(f"none of {', '.join(chosen)} has its weights")
    return Methods(fingerprints, left_out)


def best_of(methods: Methods) -> str:
    """Ours where it is among them, else the last."""
    return DEFAULT_METHOD if DEFAULT_METHOD in methods.names else methods.names[-1]


def fingerprint(name: str) -> str:
    """Of everything that decides what a method computes: its descriptor and its forest or FC4."""
    descriptor = create(name, 1)
    if descriptor.pruner is None:
        return descriptor.fingerprint
    return f"{descriptor.fingerprint}+{descriptor.pruner.fingerprint}"
