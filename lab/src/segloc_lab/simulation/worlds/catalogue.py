"""How much of a world is built alike: real streets repeat their lamps, benches, houses and cars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.errors import ConfigError


@dataclass(frozen=True)
class Catalogue:
    """Things of a few types, as they are bought, planted or built in rows.

    Attributes
    ----------
    seed : int
        Another one has other types.
    repetition : float
        Share of the things that are of a type from the catalogue, 0 to 1; the others are like no
        other.
    types : int
        Of each kind.

    Raises
    ------
    ConfigError
        If ``repetition`` is not in 0..1.
    """

    seed: int = 0
    repetition: float = 0.0
    types: int = 3

    def __post_init__(self) -> None:
        if not 0 <= self.repetition <= 1:
            raise ConfigError(f"repetition must be in 0..1, not {self.repetition}")

    def source(self, own: np.random.Generator, kind: str) -> np.random.Generator:
        """What to make the next thing of a kind from: ``own`` randomness, or that of its type.

        Equal types start from equal generators, so what is made of them is equal, too. Without
        repetition ``own`` is left as it is.
        """
        if not self.repetition or own.random() >= self.repetition:
            return own
        return np.random.default_rng(
            [self.seed, 6211, int(own.integers(self.types)), *kind.encode()]
        )
