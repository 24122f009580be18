"""Fit how wide the covariance of a pose must be on simulated worlds, and show how well it holds.

The worlds are those of ``calibration.worlds``, by other seeds: every kind is mapped in one
session and localized in by two sensors in another, with accumulated scans and with single ones of
which nothing tells how they stand; the poses of every second world err by centimetres. Every answer
within 1 m and 5 degrees of the truth gives its error and the covariance of its alignment. The first
half of the worlds fits the model (``ERRORS`` of ``segloc.likelihood.registration``), the second
half judges it: by the share of errors within the ellipsoids of 68 % and 95 %, of position and of
rotation.

    python -m segloc_lab.calibration.covariance --out covariance.npz [--real DATA]

With ``--real`` the shipped model is also shown on real recordings, whose reference poses are good
to about 1 m and 0.4 degrees between the passes of KITTI 00: they take no part in the fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from segloc import Config, Localized, Localizer, Scan, build_map, geometry
from segloc.likelihood import ERRORS, ErrorModel
from segloc.tools.batch import query_clouds
from segloc.types import Float64, LocalCloud, Pose

from ..protocols.real import maps, queries, sources
from ..report import Cell, Table, publish
from ..script import parser
from .worlds import EVERY_M, SimulatedWorld, seeds, simulated, views

FALSE_M, FALSE_DEG = 1.0, 5.0
"""Answers farther off are false: no covariance is meant to cover them."""
SHARES = (0.68, 0.95)
REAL_STEP = 5
_LEAST = (0.2, 0.2, 1e-3, 1e-3, 1e-4, 1e-4)  # of the model's parameters
Row = tuple[float, ...]
"""Number of the world, of the sensor, whether accumulated, error (6), covariance (36)."""


def error_row(result: Localized, cloud: LocalCloud, truth: Pose) -> Row | None:
    """The error of an answer and its alignment's covariance, both in the query's level frame.

    None where the answer is false, or nothing was aligned.
    """
    delta = geometry.inverse(result.T_map_sensor) @ truth
    degrees = np.degrees(geometry.rotation_angle(delta))
    if result.covariance is None or np.linalg.norm(delta[:3, 3]) > FALSE_M or degrees > FALSE_DEG:
        return None
    T_sensor_local = geometry.inverse(cloud.T_local_sensor)
    error = np.concatenate([Rotation.from_matrix(delta[:3, :3]).as_rotvec(), delta[:3, 3]])
    error = np.kron(np.eye(2), cloud.T_local_sensor[:3, :3]) @ error
    covariance = geometry.rotated_covariance(result.covariance, T_sensor_local)
    assert covariance is not None
    return *error, *_narrowed(covariance).ravel()


def _narrowed(covariance: Float64) -> Float64:
    """Invert :meth:`ErrorModel.widened` of the shipped model."""
    floor = ERRORS.widened(np.zeros((6, 6)))
    narrow: Float64 = (covariance - floor) / (ERRORS.widened(np.ones((6, 6))) - floor)
    return narrow


def rows_of(world: SimulatedWorld, config: Config) -> Iterator[Row]:
    """The errors of all queries in a world's own map."""
    localizer = Localizer(build_map(world.mapped, config), config)
    for sensor, drive in enumerate(world.queries.values()):
        for i, accumulated, scan in views(drive, EVERY_M, config.local_cloud):
            for mode, scans in enumerate(([Scan(scan.points)], accumulated)):
                query = localizer.describe(scans)
                found = localizer.locate(query)
                if found.localized and (error := error_row(found, query.cloud, drive.truth[i])):
                    yield (sensor, mode, *error)


def real_rows(data: Path, config: Config) -> tuple[Float64, list[str]]:
    """The errors of queries of real recordings in the maps of their places, and their names."""
    localizers = {
        name: Localizer(made, config) for name, made in maps(sources(data), config).items()
    }
    rows: list[Row] = []
    names: list[str] = []
    for chosen in queries(data, REAL_STEP):
        if chosen.truths is None or "turned" in chosen.name:
            continue
        clouds = query_clouds(chosen.recording, chosen.positions, config)
        for (cloud, _), truth in zip(clouds, chosen.truths, strict=True):
            query = localizers[chosen.maps[0]].describe(cloud)
            found = localizers[chosen.maps[0]].locate(query)
            if found.localized and (error := error_row(found, cloud, truth)):
                rows.append((len(names), 0, float(cloud.num_scans > 1), *error))
        names.append(chosen.name)
    return np.array(rows), names


def squares(rows: Float64, model: ErrorModel) -> Float64:
    """The squared errors of rotation and of position by their covariances, (N, 2)."""
    found = np.empty((len(rows), 2))
    for k, (error, covariance) in enumerate(zip(rows[:, 3:9], rows[:, 9:], strict=True)):
        wide = model.widened(covariance.reshape(6, 6))
        for part in range(2):
            block = slice(3 * part, 3 * part + 3)
            found[k, part] = error[block] @ np.linalg.solve(wide[block, block], error[block])
    return found


def within(rows: Float64, model: ErrorModel) -> Float64:
    """Shares of errors within the ellipsoids of ``SHARES``, (2 parts, 2 shares)."""
    limits = chi2.ppf(SHARES, 3)
    shares: Float64 = (squares(rows, model)[:, :, None] <= limits).mean(axis=0)
    return shares


def fitted(rows: Float64) -> ErrorModel:
    """The model under which the errors are likeliest, each world counting alike.

    Errors are taken to have Student's t distribution with 6 degrees of freedom, in which a few
    large ones do not widen all; the scales are then set so that the ellipsoids of 95 % hold 95 %.
    """
    _, world, counts = np.unique(rows[:, 0], return_inverse=True, return_counts=True)
    weights = 1.0 / counts[world]
    covariances = rows[:, 9:].reshape(-1, 6, 6)
    errors = rows[:, 3:9]

    def cost(logs: Float64) -> float:
        model = ErrorModel(*np.maximum(np.exp(logs), _LEAST))
        wide = np.array([model.widened(each) for each in covariances])
        total = 0.0
        for block in (slice(0, 3), slice(3, 6)):
            part, error = wide[:, block, block], errors[:, block]
            square = np.einsum("ni,ni->n", error, np.linalg.solve(part, error[..., None])[..., 0])
            tails = 0.5 * (6 + 3) * np.log1p(square / 6)
            total += float((weights * (0.5 * np.linalg.slogdet(part)[1] + tails)).sum())
        return total

    start = np.log([1.0, 1.0, 0.2, 0.1, 0.02, 0.02])
    found = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 2000, "fatol": 1e-4})
    return _holding(ErrorModel(*np.maximum(np.exp(found.x), _LEAST).tolist()), rows, weights)


def _holding(model: ErrorModel, rows: Float64, weights: Float64) -> ErrorModel:
    """The model with both parts widened alike until 95 % of the weighed errors are within 95 %."""
    found = squares(rows, model)
    wider = []
    for part in range(2):
        order = np.argsort(found[:, part])
        reached = np.cumsum(weights[order]) / weights.sum()
        largest = found[order, part][np.searchsorted(reached, SHARES[1])]
        wider.append(float(np.sqrt(largest / chi2.ppf(SHARES[1], 3))))
    turn, shift = wider
    values = np.array(astuple(model)) * [turn, shift, turn, turn, shift, shift]
    return ErrorModel(*(float(f"{value:.2g}") for value in values))


def report(rows: Float64, names: list[str], models: dict[str, ErrorModel]) -> None:
    """Print the shares within the ellipsoids, by model, mode and kind of world."""
    kind = np.array([name.rstrip(" 0123456789") for name in names])[rows[:, 0].astype(int)]
    parts = {"all": np.ones(len(rows), dtype=bool)}
    parts |= {"single": rows[:, 2] == 0, "accumulated": rows[:, 2] == 1}
    parts |= {name: kind == name for name in dict.fromkeys(kind)}
    table: list[tuple[Cell, ...]] = []
    for name, chosen in parts.items():
        some = rows[chosen]
        if not len(some):
            continue
        deg = np.degrees(np.median(np.linalg.norm(some[:, 3:6], axis=1)))
        m = np.median(np.linalg.norm(some[:, 6:9], axis=1))
        for label, model in models.items():
            shares = [f"{share:.0%}" for share in within(some, model).ravel()]
            table.append((name, len(some), label, f"{deg:.2f}", f"{m:.3f}", *shares))
    columns = ("errors", "n", "model", "deg", "m", "rotation 68 %", "95 %", "position 68 %", "95 %")
    publish(None, "", Table(columns, table))


def measured(first_seed: int, each: int, out: Path) -> None:
    """Localize in all worlds; rows are kept after each."""
    config = Config(threads=1)
    rows: list[Row] = []
    names: list[str] = []
    for world in itertools.starmap(simulated, seeds(first_seed, each)):
        rows += [(len(names), *found) for found in rows_of(world, config)]
        names.append(world.name)
        np.savez(out, rows=np.array(rows), names=np.array(names))
        print(f"{world.name}: {len(rows)} errors so far", flush=True)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--each", type=int, default=2, help="worlds of every kind")
    options.add_argument("--first-seed", type=int, default=7000)
    options.add_argument("--out", type=Path, default=Path("covariance.npz"))
    options.add_argument("--rows", type=Path, help="rows of an earlier run")
    options.add_argument("--real", type=Path, metavar="DATA", help="folder of real recordings")
    args = options.parse_args()
    if args.rows is None:
        measured(args.first_seed, args.each, args.out)
    with np.load(args.rows or args.out, allow_pickle=False) as kept:
        rows, names = kept["rows"], kept["names"].tolist()
    half = (len(names) + 1) // 2
    fits = rows[:, 0] < half
    model = fitted(rows[fits])
    print(f"{model}\n\nfitted on {', '.join(names[:half])}\n")
    models = {"alignment": ErrorModel(1.0, 1.0, 0.0, 0.0, 0.0, 0.0), "shipped": ERRORS}
    report(rows[~fits], names, {**models, "fitted": model})
    if args.real is not None:
        report(*real_rows(args.real, Config(threads=1)), models)


if __name__ == "__main__":
    main()
