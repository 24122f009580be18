"""Wrong values of worlds, sensors, platforms and drives are refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from segloc_lab.simulation import (
    SCENES,
    Conditions,
    Flight,
    Gait,
    Motion,
    OdometryNoise,
    Route,
    World,
    building,
    car,
    hdl64e,
    lms151,
    mid360,
    offices,
    os1_64,
    simulate_sessions,
    solid_state,
    town,
    vlp16,
    warehouse,
    wheeled,
)

from segloc.errors import ConfigError

NAN = float("nan")


def walks(**more: float) -> Gait:
    return Gait(steps_hz=2, bob_m=0, sway_m=0, pitch_deg=0, roll_deg=0, wander_deg=0, **more)


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: vlp16().thinned(0), "factor"),
        (lambda: hdl64e(0), "azimuth_steps"),
        (lambda: replace(hdl64e(), elevations_deg=()), "elevations_deg"),
        (lambda: replace(os1_64(), azimuths_deg=()), "azimuths_deg"),
        (lambda: replace(hdl64e(), range_sigma_m=-0.1), "range_sigma_m"),
        (lambda: replace(hdl64e(), beam_bias_sigma_m=NAN), "beam_bias_sigma_m"),
        (lambda: replace(hdl64e(), min_range_m=5.0, max_range_m=4.0), "min_range_m"),
        (lambda: replace(hdl64e(), reference_range_m=0.0), "reference_range_m"),
        (lambda: replace(hdl64e(), mount_height_m=NAN), "mount_height_m"),
        (lambda: replace(vlp16(), divergence_mrad=-1.0), "divergence_mrad"),
        (lambda: replace(vlp16(), rate_hz=0.0), "rate_hz"),
        (lambda: solid_state(0), "firings"),
        (lambda: replace(solid_state(), view_deg=(0.0, 70.0)), "view_deg"),
        (lambda: replace(solid_state(), beams=200), "view_deg"),
        (lambda: mid360(0), "firings"),
        (lambda: replace(mid360(), elevations_deg=(10.0, 5.0)), "elevations_deg"),
        (lambda: replace(mid360(), nods_hz=0.0), "nods_hz"),
        (lambda: lms151(1), "steps"),
        (lambda: replace(lms151(), view_deg=400.0), "view_deg"),
        (lambda: replace(car(), speed_mps=NAN), "speed_mps"),
        (lambda: replace(wheeled(), mount_rpy_deg=(0.0, NAN, 0.0)), "mount_rpy_deg"),
        (lambda: Flight(low_m=0.0), "low_m"),
        (lambda: Flight(low_m=9.0, high_m=8.0), "high_m"),
        (lambda: Flight(gust_deg=-1.0), "gust_deg"),
        (lambda: Flight(cruise_deg=NAN), "cruise_deg"),
        (lambda: walks(lean_deg=-1.0), "lean_deg"),
        (lambda: walks(most_deg=0.0), "most_deg"),
        (lambda: Motion(np.array([0.0]), np.eye(4)[None]), "two knots"),
        (lambda: Motion(np.array([0.0, 0.0]), np.tile(np.eye(4), (2, 1, 1))), "must rise"),
        (lambda: Motion(np.array([0.0, 1.0]), np.tile(np.eye(4), (2, 1, 1))).at([NAN]), "finite"),
        (lambda: OdometryNoise(drift_m=-1.0), "drift_m"),
        (lambda: Route((0, 1), spacing_m=0.0), "spacing_m"),
        (lambda: Route((0, 1), lane_offset_m=5.0), "lane_offset_m"),
        (lambda: Route((0, 1), length_m=-3.0), "length_m"),
        (lambda: Conditions(foliage=-0.1), "foliage"),
        (lambda: Conditions(replaced=1.1), "replaced"),
        (lambda: Conditions(scaffolding=NAN), "scaffolding"),
        (lambda: Conditions(snow=2.0), "snow"),
        (lambda: town(0, size_m=20.0), "size_m"),
        (lambda: town(-1), "seed"),
        (lambda: warehouse(0, size_m=1000.0), "size_m"),
        (lambda: building(0, storeys=0), "storeys"),
        (lambda: building(0, storeys=21), "storeys"),
        (lambda: building(0, differ=1.5), "differ"),
        (lambda: building(0, differ=NAN), "differ"),
        *((lambda s=s: SCENES[s](1, repetition=1.5), "repetition") for s in ("terraces", "forest")),
    ],
)
def test_wrong_values(make: Callable[[], object], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ask", "fault"),
    [
        (lambda small: Route((0,)).poses(small, 1.7), "two junctions"),
        (lambda small: Route((0, 0)).poses(small, 1.7), "no street"),
        (lambda small: small.session(-1), "session"),
        (lambda _: building(5, size_m=40.0).floor(5), "storey"),
        (lambda _: warehouse(5, size_m=60.0).floor(-1), "storey"),
        (
            lambda _: simulate_sessions(
                offices(5, size_m=40.0), vlp16(30), [Conditions()], length_m=20.0, storey=1
            ),
            "storey",
        ),
    ],
)
def test_what_a_world_does_not_have(
    ask: Callable[[World], object], fault: str, small: World
) -> None:
    with pytest.raises(ConfigError, match=fault) as caught:
        ask(small)
    assert "\n" not in str(caught.value)
