"""How fast scans are cast, against trimesh with embreex on the same scene and rays.

    python -m segloc_lab.protocols.simulation_speed

Both use the same ray caster. trimesh gives the points where rays meet the mesh; segloc's scans also
have noise, lost and mixed returns, glass and object ids. Needs the extra ``bench``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process a core is the fastest way to share

import multiprocessing
import time
from collections.abc import Callable, Iterator
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Barrier

import numpy as np
from rich.progress import track

from segloc.system.machine import processor
from segloc.types import Float64

from ..results.store import Result
from ..script import storing
from ..simulation import SENSORS, Lidar, Route, World, town

Cast = Callable[[int], int]
Row = tuple[str | int | float, ...]
COLUMNS = (
    *("sensor", "processes", "by", "ms a scan", "processor ms", "M rays/s", "M points/s"),
    "times as fast, by processor",
)
COMMAND = "python -m segloc_lab.protocols.simulation_speed"


def segloc_scan(world: World, sensor: Lidar, poses: Float64) -> Cast:
    """Number of points of the k-th scan."""
    scene = world.session(0)
    return lambda k: len(sensor.scan(scene, poses[k], np.random.default_rng(k))[0])


def trimesh_rays(world: World, sensor: Lidar, poses: Float64) -> Cast:
    """The same by trimesh, as its documentation has it."""
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    vertices, faces = world.terrain.mesh()
    soups = [vertices[faces], world.static.triangles, world.changing(0).triangles]
    corners = np.concatenate(soups).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    caster = RayMeshIntersector(mesh)

    def cast(k: int) -> int:
        directions = sensor.rays(np.random.default_rng(k).random()).directions @ poses[k, :3, :3].T
        origins = np.broadcast_to(poses[k, :3, 3], directions.shape)
        _, rays, places = caster.intersects_id(
            origins, directions, multiple_hits=False, return_locations=True
        )
        points = (places - poses[k, :3, 3]) @ poses[k, :3, :3]
        near = np.linalg.norm(points, axis=1) < sensor.max_range_m
        return len(points[near]) if len(rays) else 0

    return cast


ENGINES = {"trimesh": trimesh_rays, "segloc": segloc_scan}


def work(
    engine: str,
    name: str,
    seed: int,
    scans: int,
    ready: Barrier,
    done: Queue[tuple[float, float, int]],
) -> None:
    """One process: seconds, processor seconds and points of scans, once all are ready."""
    world, sensor = town(seed), SENSORS[name]()
    junctions = world.roads.walk(np.random.default_rng(seed), [0], 2.0 * scans, avoid=[])
    poses = Route(tuple(junctions)).poses(world, sensor.mount_height_m)
    cast = ENGINES[engine](world, sensor, poses)
    cast(0)
    ready.wait()
    began, busy = time.perf_counter(), time.process_time()
    points = sum(cast(k) for k in range(scans))
    done.put((time.perf_counter() - began, time.process_time() - busy, points))


def measure(
    engine: str, name: str, seed: int, scans: int, processes: int
) -> tuple[float, float, float]:
    """Seconds a scan over all processes, processor seconds a scan, and points a scan."""
    context = multiprocessing.get_context("spawn")
    ready, done = context.Barrier(processes), context.Queue()
    arguments = (engine, name, seed, scans, ready, done)
    team = [context.Process(target=work, args=arguments) for _ in range(processes)]
    for process in team:
        process.start()
    results = [done.get() for _ in team]
    for process in team:
        process.join()
    total = scans * processes
    seconds, busy, points = (list(column) for column in zip(*results, strict=True))
    return max(seconds) / total, sum(busy) / total, sum(points) / total


def rows(name: str, seed: int, scans: int, processes: int) -> Iterator[Row]:
    """Both engines on one sensor."""
    rays = len(SENSORS[name]().rays(0.0).directions)
    base = 0.0
    for engine in ENGINES:
        seconds, busy, points = measure(engine, name, seed, scans, processes)
        base = base or busy
        times = (round(1000 * seconds, 1), round(1000 * busy, 1))
        rates = (round(rays / seconds / 1e6, 2), round(points / seconds / 1e6, 2))
        yield name, processes, engine, *times, *rates, round(base / busy, 2)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--sensors", nargs="+", default=["hdl64e", "vlp16"])
    options.add_argument("--scans", type=int, default=40, help="of each process")
    options.add_argument("--seed", type=int, default=7, help="of the town")
    args = options.parse_args()
    runs = [(name, processes) for name in args.sensors for processes in (1, 2)]
    found = [
        row
        for name, processes in track(runs, "Casting rays")
        for row in rows(name, args.seed, args.scans, processes)
    ]
    command = f"{COMMAND} --seed {args.seed} --scans {args.scans} --store docs/results"
    note, stages = f"Machine: {processor()}.", ("simulation",)
    Result.measured("simulation-speed", command, COLUMNS, found, stages=stages, note=note).tell(
        args.store
    )


if __name__ == "__main__":
    main()
