"""A car park: rows of bays between lanes, lamps and trees at even distances, little else."""

from __future__ import annotations

import numpy as np

from ..objects.buildings import house
from ..objects.fixtures import bus_shelter, cabinet, lamp, traffic_sign
from .layout import Frontage, Site, check_world, lay_kerb, paved_site, town_tree
from .roads import street_network
from .world import Catalogue, World, remember

_MARGIN, _BLOCK = 30.0, 46.0
_BAY = (2.5, 5.0)  # metres
_ROWS = (2.9, 8.1)  # of the middles of bays beyond the kerb, metres
_EVERY = 9  # bays from lamp to lamp


@remember
def car_park(seed: int, *, size_m: float = 240.0, repetition: float = 0.9) -> World:
    """A car park of about ``size_m`` metres square; the same for the same seed.

    Parameters
    ----------
    repetition : float
        Share of the cars, lamps, trees and shelters that are of a few types, 0 to 1.
    """
    check_world(seed, size_m, 130.0, 600.0)
    catalogue = Catalogue(seed, repetition)
    rng = np.random.default_rng([seed, 32_452_843])
    lanes = street_network(
        rng, size_m, margin_m=_MARGIN, block_m=_BLOCK, half_width=(2.9, 3.1), shift=0.08, bend=0.02
    )
    site = paved_site(rng, lanes, size_m, slope=0.012, paved_m=40.0)
    site.green, site.catalogue = 0.2, catalogue
    busy = float(rng.uniform(0.55, 0.9))
    for street in lanes.streets:
        for side in (1, -1):
            front = Frontage(street, side, 1.0, "green")
            lay_kerb(site, front)
            _bays(site, front, busy)
    _buildings(site, size_m)
    return site.world("car_park", seed)


def _bays(site: Site, front: Frontage, busy: float) -> None:
    """Two rows of bays, and what stands on the islands between them."""
    places = np.arange(7.0, front.street.length - 7.0, _BAY[0])
    for k, s in enumerate(places):
        if k % _EVERY == _EVERY // 2:
            _island(site, front, float(s))
            continue
        for beyond in _ROWS:
            at, yaw = front.at(float(s), beyond)
            turn = float(yaw) + np.pi / 2
            free = site.roads.clearance(at) > _BAY[1] / 2 - 0.3
            if free and site.ground.claim(at, (_BAY[1], _BAY[0] - 0.2), turn):
                site.parking.append((*at, turn, _BAY[1] + 0.3, busy))
    walkers = site.rng.uniform(5, max(6.0, front.street.length - 5), int(front.street.length / 12))
    site.people.extend(front.at(walkers, 0.3)[0])


def _island(site: Site, front: Frontage, s: float) -> None:
    rng = site.rng
    at, yaw = front.at(s, _ROWS[0])
    pick = rng.random()
    if pick < 0.5:
        site.stand("lamp", lamp(site.like("lamp")), at, float(yaw) - np.pi / 2, 0.4)
    elif pick < 0.85:
        site.stand("tree", town_tree(site.like("tree"), 4.0, 7.0), at, float(yaw), 0.7)
    elif pick < 0.93:
        site.stand("traffic sign", traffic_sign(site.like("sign")), at, float(yaw), 0.4)
    else:
        site.stand("cabinet", cabinet(site.like("cabinet")), at, float(yaw), 0.8)
    at, yaw = front.at(s, _ROWS[1])
    if rng.random() < 0.35:
        shelter = bus_shelter(site.like("shelter"))
        site.stand("shelter", shelter, at, float(yaw) - np.pi / 2, 2.0)


def _buildings(site: Site, size_m: float) -> None:
    """A few large ones about the edge, of one type where things repeat."""
    rng = site.rng
    for along in np.arange(_MARGIN, size_m - _MARGIN, 45.0):
        for at, turn in (
            ((along, 9.0), np.pi), ((along, size_m - 9.0), 0.0),
            ((9.0, along), np.pi / 2), ((size_m - 9.0, along), -np.pi / 2),
        ):  # fmt: skip
            if rng.random() < 0.6:
                block = house(site.like("block"), 22.0, 10.0, floors=3, flats=True)
                plan = (block.width, block.depth)
                site.erect("house", block.mesh, np.array(at), plan, turn)
