"""Drawing simulated worlds and the drives through them that a dataset is made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ..errors import ConfigError
from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    Lidar,
    LineLidar,
    Route,
    SimulatedSequence,
    SpinningLidar,
    simulate_session,
)

_USUAL_SENSORS = ("hdl64e", "hdl64e", "hdl64e", "hdl32e", "vlp16", "os1-64", "os1-128", "lms151")
_WALKERS = ("wheeled", "legged", "handheld")


class WorldSpec(BaseModel):
    """One world, and the sessions that are driven in it; the same again for the same values."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    seed: int = Field(ge=0)
    size_m: float = Field(330.0, gt=0)
    length_m: float = Field(500.0, gt=0, description="of each drive")
    sensors: tuple[str, ...]
    lanes_m: tuple[float, ...]
    reverse: tuple[bool, ...]
    platforms: tuple[str, ...]
    raised_m: tuple[float, ...]
    foliage: tuple[float, ...]
    replaced: tuple[float, ...]
    swathe_m: float = 30.0

    @property
    def name(self) -> str:
        return f"{self.scene}-{self.seed}"

    @property
    def sessions(self) -> int:
        return len(self.sensors)

    def sweeps(self, k: int) -> bool:
        """Whether session k's sensor is a push-broom one, which needs its motion to see."""
        return isinstance(_sensor(self.sensors[k]), LineLidar)


def draw_worlds(
    text: str, seed: int, *, length_m: float = 500.0, sensors: tuple[str, ...] = ()
) -> list[WorldSpec]:
    """Worlds as ``town:10,park:4`` asks for them.

    Each has two or three sessions, in different lanes and seasons, some the other way round, each
    with a sensor, a carrier and a mounting height of its own; from session to session some objects
    have been replaced.

    Raises
    ------
    ConfigError
        If the text cannot be read or names a scene or a sensor that does not exist.
    """
    wanted = sensors or _USUAL_SENSORS
    for name in wanted:
        if name not in SENSORS:
            raise ConfigError(f"no sensor {name!r}; there are {', '.join(sorted(SENSORS))}")
    specs: list[WorldSpec] = []
    for part in text.split(","):
        scene, _, number = part.strip().partition(":")
        if scene not in SCENES:
            raise ConfigError(f"no scene {scene!r}; there are {', '.join(sorted(SCENES))}")
        if not number.isdecimal() or not 0 < int(number) <= 10_000:
            raise ConfigError(f"{part.strip()!r} does not say how many: write {scene}:10")
        specs += [_draw(scene, seed, i, length_m, wanted) for i in range(int(number))]
    return specs


def _draw(scene: str, seed: int, i: int, length_m: float, sensors: tuple[str, ...]) -> WorldSpec:
    rng = np.random.default_rng([seed, i, *scene.encode()])
    sessions = int(rng.integers(2, 4))
    later = range(sessions - 1)
    carriers = ("car",) if scene == "town" else _WALKERS
    return WorldSpec(
        scene=scene,
        seed=10_000 * seed + i,
        length_m=length_m,
        sensors=tuple(str(rng.choice(sensors)) for _ in range(sessions)),
        lanes_m=tuple(float(rng.uniform(0.3, 1.9)) for _ in range(sessions)),
        reverse=(False, *(bool(rng.random() < 0.5) for _ in later)),
        platforms=tuple(str(rng.choice(carriers)) for _ in range(sessions)),
        raised_m=tuple(float(rng.uniform(-0.15, 0.35)) for _ in range(sessions)),
        foliage=tuple(float(rng.uniform(0.2, 1.0)) for _ in range(sessions)),
        replaced=(0.0, *(float(rng.uniform(0.0, 0.2)) for _ in later)),
    )


def _sensor(name: str) -> Lidar:
    """A sensor with about half of its firings where that is enough for dense local clouds."""
    sensor = SENSORS[name]()
    return sensor.thinned(2) if isinstance(sensor, SpinningLidar) else sensor


def simulated_drive(spec: WorldSpec, k: int) -> SimulatedSequence:
    """Session k of a world, with its true poses."""
    world = SCENES[spec.scene](spec.seed, size_m=spec.size_m)
    rng = np.random.default_rng([spec.seed, 31])
    start = int(rng.integers(len(world.roads.nodes)))
    way = world.roads.walk(rng, [start], spec.length_m, avoid=[])
    junctions = tuple(way[::-1] if spec.reverse[k] else way)
    route = Route(junctions, lane_offset_m=spec.lanes_m[k], length_m=spec.length_m)
    carrier = PLATFORMS[spec.platforms[k]]()
    return simulate_session(
        world,
        k,
        route,
        _sensor(spec.sensors[k]),
        spec.seed,
        conditions=Conditions(foliage=spec.foliage[k], replaced=spec.replaced[k]),
        platform=replace(carrier, mount_height_m=carrier.mount_height_m + spec.raised_m[k]),
        by_rate=spec.sweeps(k),
    )
