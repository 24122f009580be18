"""Drawing simulated worlds and the drives through them that a dataset is made of."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from pydantic import Field

from segloc.errors import ConfigError
from segloc.system.section import Section

from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    LineLidar,
    Route,
    SimulatedSequence,
    simulate_session,
)

_LANE_OF = 3.4  # half the width of a street that has room for all lanes, metres
_SWEEP_SPACING_M = 0.15
_USUAL_SENSORS = ("hdl64e", "hdl64e", "hdl64e", "hdl32e", "vlp16", "os1-64", "os1-128", "lms151")
_CARRIERS = {"town": ("car",), "terraces": ("car",)}
_WALKERS = ("wheeled", "legged", "carried")


class Drive(Section):
    """One session of a world."""

    sensor: str
    thin: int = Field(1, ge=1, description="every so many firings: faster scans of fewer points")
    lane_m: float
    reverse: bool
    foliage: float
    replaced: float
    scaffolding: float
    carrier: str = Field(description="one of PLATFORMS")
    raised_m: float = Field(description="of its sensor above where it usually sits")


class WorldSpec(Section):
    """One world, and the sessions that are driven in it; the same again for the same values."""

    scene: str
    seed: int = Field(ge=0)
    length_m: float = Field(500.0, gt=0, description="of each drive")
    drives: tuple[Drive, ...]

    @property
    def name(self) -> str:
        return f"{self.scene}-{self.seed}"


def draw_worlds(
    text: str,
    seed: int,
    *,
    length_m: float = 500.0,
    sensors: tuple[str, ...] = (),
    thin: int = 1,
) -> list[WorldSpec]:
    """Worlds as ``town:10,park:4`` asks for them.

    Each has two or three sessions, in different lanes and seasons, some the other way round, with
    some things replaced, each with a sensor of its own on a carrier of its own.

    Raises
    ------
    ConfigError
        If the text cannot be read or names a scene or a sensor that does not exist, or if the
        length is not positive.
    """
    if not 0 < length_m < math.inf:
        raise ConfigError(f"a drive must have a positive number of metres, not {length_m}")
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
        specs += [_draw(scene, seed, i, length_m, wanted, thin) for i in range(int(number))]
    return specs


def _draw(
    scene: str, seed: int, i: int, length_m: float, sensors: tuple[str, ...], thin: int
) -> WorldSpec:
    rng = np.random.default_rng([seed, i, *scene.encode()])
    drives = tuple(
        Drive(
            sensor=str(rng.choice(sensors)),
            thin=thin,
            lane_m=float(rng.uniform(-0.3, 1.9)),
            reverse=bool(k > 0 and rng.random() < 0.5),
            foliage=float(rng.choice([0.0, 1.0]) if rng.random() < 0.5 else rng.random()),
            replaced=float(rng.uniform(0.0, 0.3)),
            scaffolding=float(rng.uniform(0.0, 0.1)),
            carrier=str(rng.choice(_CARRIERS.get(scene, _WALKERS))),
            raised_m=float(rng.uniform(-0.15, 0.35)),
        )
        for k in range(int(rng.integers(2, 4)))
    )
    return WorldSpec(scene=scene, seed=10_000 * seed + i, length_m=length_m, drives=drives)


def simulated_drive(spec: WorldSpec, k: int) -> SimulatedSequence:
    """Session k of a world, with its true poses; all sessions share most of their way."""
    drive = spec.drives[k]
    world = SCENES[spec.scene](spec.seed)
    sensor = SENSORS[drive.sensor]().thinned(drive.thin)
    rng = np.random.default_rng([spec.seed, 31])
    start = int(rng.integers(len(world.roads.nodes)))
    way = world.roads.walk(rng, [start], spec.length_m, avoid=[])
    narrowest = min(street.half_width for street in world.roads.streets)
    route = Route(
        tuple(way[::-1] if drive.reverse else way),
        drive.lane_m * min(1.0, narrowest / _LANE_OF),
        _SWEEP_SPACING_M if sweeps(drive) else 2.0,
        spec.length_m,
    )
    conditions = Conditions(drive.foliage, drive.replaced, drive.scaffolding)
    carrier = PLATFORMS[drive.carrier]()
    carrier = replace(carrier, mount_height_m=carrier.mount_height_m + drive.raised_m)
    return simulate_session(
        world, k, route, sensor, spec.seed, conditions=conditions, platform=carrier
    )


def sweeps(drive: Drive) -> bool:
    """Whether the sensor is a push-broom one, which needs the vehicle's motion to see."""
    return isinstance(SENSORS[drive.sensor](), LineLidar)
