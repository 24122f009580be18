"""A town: curved streets, houses with gardens, street furniture, trees, places to park."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..objects.buildings import shed
from ..objects.fixtures import FURNITURE, lamp, traffic_light, traffic_sign, utility_pole
from ..objects.vegetation import bush
from .layout import Frontage, Site, check_world, lay_kerb, paved_site, town_tree
from .lots import build_along, dress
from .roads import Street, street_network
from .world import Catalogue, World, remember

_MARGIN = 38.0
_BLOCK = 68.0
_OUTER_LANE = 3.85  # from the centre line: clear of whoever maps the street


_TERRACED = (0.0, 0.9, 0.1, 0.0, 0.0)
BUILDINGS = ("villas", "terrace", "flats", "mixed", "green")


def town(seed: int, *, size_m: float = 330.0, repetition: float = 0.0) -> World:
    """A town of about ``size_m`` metres square; the same for the same seed, whatever the process.

    Parameters
    ----------
    repetition : float
        Share of the lamps, signs, benches, street trees, houses and cars that are of a few types,
        0 to 1.
    """
    return _town(seed, size_m, repetition, False)


def terraces(seed: int, *, size_m: float = 330.0, repetition: float = 0.9) -> World:
    """A town of terraced houses, nearly all of them of a few types, with little that grows."""
    return _town(seed, size_m, repetition, True)


@remember
def _town(seed: int, size_m: float, repetition: float, terraced: bool) -> World:
    check_world(seed, size_m, 130.0, 2000.0)
    catalogue = Catalogue(seed, repetition)
    rng = np.random.default_rng([seed, 104729])
    character = draw_character(rng)
    if terraced:
        character = replace(character, buildings=_TERRACED, green=0.15, setback=0.6)
    roads = street_network(
        rng, size_m, margin_m=_MARGIN, block_m=_BLOCK, half_width=character.half_width
    )
    slope = float(rng.uniform(0.015, 0.045))
    site = paved_site(rng, roads, size_m, slope=slope, paved_m=2.5)
    site.green, site.catalogue = character.green, catalogue
    fronts = [
        _frontage(rng, character, street, side) for street in roads.streets for side in (1, -1)
    ]
    for front in fronts:
        lay_kerb(site, front)
        _pavement(site, front)
    for node in range(len(roads.nodes)):
        _junction(site, node)
    lots = [lot for front in fronts for lot in build_along(site, front)]
    for lot in lots:
        dress(site, lot)
    for front in fronts:
        _street_parking(site, front, character.parked)
        _traffic(site, front)
    _gardens(site, size_m)
    return site.world("terraces" if terraced else "town", seed)


def _frontage(
    rng: np.random.Generator, character: Character, street: Street, side: int
) -> Frontage:
    built = str(rng.choice(BUILDINGS, p=character.buildings))
    return Frontage(street, side, float(rng.uniform(*character.pavement)), built, character.setback)


def _pavement(site: Site, front: Frontage) -> None:
    """Lamps, poles, street trees and furniture between kerb and gardens."""
    rng, length = site.rng, front.street.length
    if rng.random() < 0.75:
        for s in np.arange(rng.uniform(6, 20), length - 6, rng.uniform(24, 38)):
            at, yaw = front.at(s + rng.normal(0, 1.0), rng.uniform(0.3, 0.6))
            site.stand("lamp", lamp(site.like("lamp")), at, float(yaw) - np.pi / 2, 0.4)
    else:
        for s in np.arange(rng.uniform(6, 25), length - 6, rng.uniform(28, 42)):
            at, yaw = front.at(s + rng.normal(0, 1.5), front.pavement - 0.25)
            site.stand("pole", utility_pole(site.like("pole")), at, float(yaw), 0.4)
    if rng.random() < 0.25 + 0.6 * site.green:
        pitch = rng.uniform(6, 13)
        tall = float(rng.uniform(6, 13))
        for s in np.arange(rng.uniform(8, 14), length - 8, pitch):
            at, yaw = front.at(s + rng.normal(0, 0.5), rng.uniform(0.6, 0.9))
            if rng.random() < 0.85:
                grown = town_tree(site.like("street tree"), 0.7 * tall, 1.2 * tall)
                site.stand("tree", grown, at, float(yaw), 0.7)
    shares = np.array([share for _, _, share, _ in FURNITURE])
    for s in rng.uniform(7, max(8.0, length - 7), int(length / 17)):
        kind, make, _, out = FURNITURE[int(rng.choice(len(FURNITURE), p=shares / shares.sum()))]
        at, yaw = front.at(s, min(out, front.pavement - 0.2))
        turn = 0.0 if kind in ("traffic sign", "name sign") else -np.pi / 2
        site.stand(kind, make(site.like(kind)), at, float(yaw) + turn, min(2 * out, 1.6))
    walkers = rng.uniform(3, max(4.0, length - 3), int(length / 7))
    site.people.extend(front.at(walkers, rng.uniform(0.4, front.pavement, len(walkers)))[0])


def _junction(site: Site, node: int) -> None:
    """Signs at the corners, sometimes traffic lights."""
    rng, middle = site.rng, site.roads.nodes[node]
    lights = rng.random() < 0.25
    for angle in rng.uniform(0, 2 * np.pi) + np.arange(8) * np.pi / 4:
        way = np.array([np.cos(angle), np.sin(angle)])
        for reach in np.arange(4.0, 11.0, 0.5):
            at = middle + reach * way
            if site.roads.clearance(at) > 0.5:
                if rng.random() < 0.45:
                    kind = "traffic light" if lights else "traffic sign"
                    mesh = (traffic_light if lights else traffic_sign)(site.like(kind))
                    site.stand(kind, mesh, at, float(angle + np.pi + rng.normal(0, 0.4)), 0.4)
                break


def _street_parking(site: Site, front: Frontage, parked: float) -> None:
    """Cars by the kerb, half on the pavement in narrow streets, in groups with gaps."""
    rng, street = site.rng, front.street
    if rng.random() < 0.1:
        return
    busy = min(1.0, rng.uniform(0.85, 1.15) * parked)
    for s in np.arange(8.0, street.length - 8.0, rng.uniform(5.4, 6.4)):
        at, yaw = front.at(s, -0.55)
        ends, _ = front.at(np.array([s - 3.5, s + 3.5]), -0.55)
        if site.roads.clearance(ends).min() > -0.8 and site.ground.free(at, (5.2, 1.9), float(yaw)):
            site.parking.append((*at, float(yaw), 5.3 if rng.random() < 0.8 else 6.2, busy))
        if rng.random() < 0.12:
            rack, _ = front.at(s, front.pavement - 0.4)
            site.bicycles += [(*(rack + k * 0.6), float(yaw) + 1.2) for k in range(3)]


def _traffic(site: Site, front: Frontage) -> None:
    """Vehicles that drive in the outer lane of wide streets, each session elsewhere."""
    lane = front.street.half_width - 2.75  # beside those that park
    if lane < _OUTER_LANE:
        return
    for s in np.arange(16.0, front.street.length - 16.0, 14.0):
        at, yaw = front.at(s, lane - front.street.half_width)
        site.parking.append((*at, float(yaw), 13.0, 0.12))


def _gardens(site: Site, size_m: float) -> None:
    """Trees, bushes and sheds behind and between the houses."""
    rng = site.rng
    for at in rng.uniform(3, size_m - 3, (int(size_m**2 * (0.008 + 0.012 * site.green)), 2)):
        if site.roads.clearance(at) < 4.5:
            continue
        pick, yaw = rng.random(), float(rng.uniform(0, 2 * np.pi))
        if pick < 0.5:
            site.stand("tree", town_tree(rng, 4.0, 15.0), at, yaw, 1.2)
        elif pick < 0.9:
            site.stand("bush", bush(rng), at, yaw, 1.4)
        else:
            small = shed(rng)
            if site.ground.claim(at, (small.width, small.depth), yaw, 0.3):
                z = float(site.terrain.height(*at))
                site.items.append(("shed", small.mesh.moved([*at, z], yaw)))


@dataclass(frozen=True)
class Character:
    """What the streets of one town have in common."""

    buildings: tuple[float, ...]  # shares of BUILDINGS
    half_width: tuple[float, float]  # from the centre line of a street to its kerb, metres
    pavement: tuple[float, float]  # its width, metres
    setback: float  # times the usual depth of front gardens
    green: float  # how much grows, 0 to 1
    parked: float  # share of the places by the kerb that are taken


def draw_character(rng: np.random.Generator) -> Character:
    """One of four kinds of town, its shares and measures shaken."""
    kind = str(rng.choice(["suburb", "old town", "avenues", "mixed"], p=[0.4, 0.2, 0.15, 0.25]))
    shares, narrow, pavement, setback, green = {
        "suburb": ((0.55, 0.15, 0.03, 0.12, 0.15), 3.4, (1.2, 2.4), 1.05, (0.65, 1.0)),
        "old town": ((0.05, 0.7, 0.1, 0.15, 0.0), 3.3, (0.9, 1.8), 0.6, (0.05, 0.4)),
        "avenues": ((0.15, 0.2, 0.45, 0.15, 0.05), 5.6, (2.2, 4.0), 1.0, (0.35, 0.9)),
        "mixed": ((0.34, 0.24, 0.12, 0.2, 0.1), 3.4, (1.3, 2.6), 0.9, (0.4, 0.95)),
    }[kind]
    drawn = rng.dirichlet(15 * np.array(shares) + 0.05)
    return Character(
        buildings=tuple(float(share) for share in drawn),
        half_width=(narrow, narrow + float(rng.uniform(0.6, 1.6))),
        pavement=pavement,
        setback=setback * float(rng.uniform(0.75, 1.2)),
        green=float(rng.uniform(*green)),
        parked=float(rng.uniform(0.7, 1.0)),
    )
