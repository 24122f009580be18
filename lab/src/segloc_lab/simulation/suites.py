"""Named test sets: simulated stand-ins for the recordings that the method was published with."""

from __future__ import annotations

from dataclasses import dataclass, replace

from segloc.errors import ConfigError
from segloc.tools.datasets import Sequence

from ..swathes import swathes
from .drives import simulate_sessions
from .motion.platforms import PLATFORMS
from .sensors import SENSORS
from .sensors.lidar import LineLidar
from .sensors.ranging import Lidar
from .worlds import SCENES
from .worlds.world import Conditions

SWATHE_M = 30.0
_MIN_M = 90.0
_UNKNOWN_WORLDS = 500  # seeds of training worlds lie this far from those of test worlds

PAPER = "paper"
"""The scale with all of the published length and as many queries as were published."""

SUMMER = Conditions()
LATER = Conditions(foliage=0.8, replaced=0.1)
AUTUMN = Conditions(foliage=0.5, replaced=0.15, scaffolding=0.03)
WINTER = Conditions(foliage=0.1, replaced=0.2, scaffolding=0.05)


@dataclass(frozen=True)
class TestSet:
    """A map and the sessions that are to be localized in it.

    Attributes
    ----------
    kind : str
        Of surroundings, as published.
    scene : str
        Of :data:`SCENES`.
    sensor : str
        Of :data:`SENSORS`. Those of a push-broom LiDAR are gathered to swathes.
    length_m : float
        Of the way of all tests together, as published.
    clouds : int
        Of the tests, as published.
    tests : tuple of Conditions
        One a session after the one that is mapped.
    spacing_m : float
        Between scans.
    size_m : dict
        Of the world, by scale.
    share : dict
        How much of the published length is driven, by scale.
    platform : str or None
        Of :data:`PLATFORMS`.
    repetition : float or None
        How much of the world is of a few types, for scenes that take it.
    first_seed : int
        Added to every seed, so that no two sets have a world in common.
    """

    __test__ = False  # no test case, whatever a test runner makes of the name

    name: str
    kind: str
    scene: str
    sensor: str
    length_m: float
    clouds: int
    tests: tuple[Conditions, ...]
    spacing_m: float
    size_m: dict[str, float]
    share: dict[str, float]
    platform: str | None = None
    repetition: float | None = None
    first_seed: int = 0

    def every_m(self, scale: str) -> float | None:
        """Metres from query to query at which there are as many as published, at the paper's size.

        None at other scales.
        """
        return self.length_m / self.clouds if scale == PAPER else None

    def session_length_m(self, scale: str) -> float:
        """Metres of each session."""
        if scale not in self.share:
            raise ConfigError(f"scale must be one of {', '.join(self.share)}, not {scale!r}")
        return max(_MIN_M, self.share[scale] * self.length_m / len(self.tests))

    def sessions(self, scale: str = "small", *, seed: int = 0) -> dict[str, Sequence]:
        """``map``, and ``test_0`` and so on; their scans are cast on access.

        Parameters
        ----------
        scale : str
            "small" for a drive of some hundred metres, "full" for the published length, where a
            simulated world of reasonable size has room for it, "paper" for all of it.
        seed : int
            Another seed is another world.
        """
        conditions = [SUMMER, *self.tests]
        drives = self._drive(scale, seed, conditions)
        names = ["map", *(f"test_{k}" for k in range(len(self.tests)))]
        return dict(zip(names, drives, strict=True))

    def training(self, count: int, scale: str = "small", *, seed: int = 0) -> list[Sequence]:
        """Two sessions each of ``count`` worlds that no test of the same seed sees."""
        return [
            drive
            for k in range(count)
            for drive in self._drive(scale, seed + _UNKNOWN_WORLDS + k, [SUMMER, LATER])
        ]

    def _drive(self, scale: str, seed: int, conditions: list[Conditions]) -> list[Sequence]:
        length_m = self.session_length_m(scale)
        seed += self.first_seed
        more = {} if self.repetition is None else {"repetition": self.repetition}
        world = SCENES[self.scene](seed, size_m=self.size_m[scale], **more)
        drives = simulate_sessions(
            world,
            self._lidar(scale),
            conditions,
            length_m=length_m,
            spacing_m=self.spacing_m,
            seed=seed,
            platform=None if self.platform is None else PLATFORMS[self.platform](),
        )
        noisy = [drive.with_odometry() for drive in drives[1:]]
        named = [replace(drive, name=f"{self.name}-{drive.name}") for drive in (drives[0], *noisy)]
        if isinstance(named[0].sensor, LineLidar):
            return [swathes(drive, SWATHE_M) for drive in named]
        return list(named)

    def _lidar(self, scale: str) -> Lidar:
        lidar = SENSORS[self.sensor]()
        thin = scale == "small" and not isinstance(lidar, LineLidar)
        return lidar.thinned(2) if thin else lidar


SIX: tuple[TestSet, ...] = (
    TestSet(
        "robotcar", "Urban", "town", "lms151", 50_310, 1118, (LATER, AUTUMN, WINTER, LATER),
        spacing_m=0.2, size_m={"small": 260, "full": 560, "paper": 1600},
        share={"small": 0.012, "full": 0.1, "paper": 1.0}, first_seed=100_000,
    ),
    TestSet(
        "kitti", "Urban", "town", "hdl64e", 1300, 134, (LATER,),
        spacing_m=1.0, size_m={"small": 260, "full": 450, "paper": 450},
        share={"small": 0.12, "full": 1.0, "paper": 1.0},
    ),
    TestSet(
        "fire_college", "Industrial", "industrial", "vlp16", 190, 169, (LATER,),
        spacing_m=0.5, size_m={"small": 200, "full": 200, "paper": 200},
        share={"small": 0.6, "full": 1.0, "paper": 1.0},
        platform="legged",
    ),
    TestSet(
        "george_square", "City park", "park", "lms151", 500, 30, (AUTUMN,),
        spacing_m=0.2, size_m={"small": 200, "full": 240, "paper": 240},
        share={"small": 0.3, "full": 1.0, "paper": 1.0},
    ),
    TestSet(
        "cornbury", "Forest", "forest", "hdl32e", 700, 1125, (LATER,),
        spacing_m=0.6, size_m={"small": 180, "full": 240, "paper": 240},
        share={"small": 0.15, "full": 1.0, "paper": 1.0},
        platform="wheeled",
    ),
    TestSet(
        "burgess", "Meadow", "meadow", "lms151", 2800, 130, (AUTUMN,),
        spacing_m=0.2, size_m={"small": 240, "full": 340, "paper": 480},
        share={"small": 0.06, "full": 0.5, "paper": 1.0},
    ),
)  # fmt: skip
"""After Table II of Tinchev et al., "Real-time LIDAR localization in natural and urban
environments": type, length, sensor and number of clouds are the published ones."""

_ROBOTCAR, _KITTI, _FIRE_COLLEGE, _, _CORNBURY, _ = SIX

REPEATED: tuple[TestSet, ...] = (
    replace(_ROBOTCAR, name="terraces", scene="terraces", repetition=0.9, first_seed=200_000),
    replace(_KITTI, name="streets", repetition=0.8, first_seed=300_000),
    replace(_FIRE_COLLEGE, name="car_park", scene="car_park", repetition=0.9),
    replace(_CORNBURY, name="rows", repetition=0.9, first_seed=400_000),
)
"""Harder ones: the same drives where most of what stands there is of a few types."""

SUITES: dict[str, tuple[TestSet, ...]] = {"six": SIX, "repeated": REPEATED}
"""By name."""
