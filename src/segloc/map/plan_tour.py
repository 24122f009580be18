"""Where a sensor would be carried through a plan: the free floor of each storey, and a way over it.

Floor is free where a sensor has room above and beside it. Viewpoints lie where there is most room,
in each room and along corridors, and on the way from one to the next, through doorways.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree
from scipy.spatial import cKDTree

from .. import _native
from ..types import Float32, Float64, Int64
from .viewpoints import HEADROOM_M, MAX_CLEARANCE_M, STOREY_M

SPACING_M, STEP_M = 3.0, 1.5
"""Distance over the floor within which a viewpoint lies, and between two on the way [m]."""
_CELL_M, _MAX_COLUMNS = 0.25, 4_000_000
_BESIDE_M = 0.3  # to walls: a robot fits through a doorway of 0.8 m
_LEGS_M = 0.5  # height over the floor that must be free, too
_LEVEL = 0.94  # cosine of the steepest floor, 20 degrees
_RISE_M = 0.1  # between cells of one floor; stairs rise more
_MIN_AREA_M2 = 1.0  # of connected free floor, less the strip along its walls
_FAR_M = 50.0
_DIRECTIONS = 16
_MIN_WALLS = 0.2  # share of the horizontal rays that meet something; roofs have none
_INSIDE = 0.9  # share of back faces in view from within a solid
_EPSILON_M = 1e-3
_MAX_LAYERS = 200


@dataclass(frozen=True)
class PlanMesh:
    """Triangles that rays are cast at.

    Attributes
    ----------
    triangles : (T, 3, 3) float32
    rays : MeshRays
        Of these.
    threads : int
        0 is all cores; results do not depend on it.
    """

    triangles: Float32
    rays: _native.MeshRays
    threads: int

    @classmethod
    def of(cls, triangles: Float32, threads: int = 0) -> PlanMesh:
        """Prepare (T, 3, 3) triangles."""
        return cls(triangles, _native.MeshRays(triangles), threads)

    def cast(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], most_m: float
    ) -> tuple[Float32, NDArray[np.int32]]:
        """Return the range of each ray and the triangle that it meets, -1 if none.

        A single origin or direction, (1, 3), is that of all rays.
        """
        starts, rays = np.broadcast_arrays(origins, directions)
        return self.rays.cast(
            np.ascontiguousarray(starts, dtype=np.float32),
            np.ascontiguousarray(rays, dtype=np.float32),
            most_m,
            self.threads,
        )

    def normals(self, rows: NDArray[np.int32]) -> Float64:
        """Return unit normals of some triangles, (N, 3); zero of those without area."""
        a, b, c = self.triangles[rows].astype(np.float64).transpose(1, 0, 2)
        normals: Float64 = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return normals / np.where(length > 0, length, 1.0)


@dataclass(frozen=True)
class Floor:
    """Cells of connected free floor.

    Attributes
    ----------
    eyes : (N, 3) float64
        Place of a sensor over each cell [m].
    clearance : (N,) float64
        Distance to the nearest wall at that height [m].
    edge_m : float
        Side of a cell.
    """

    eyes: Float64
    clearance: Float64
    edge_m: float

    @property
    def area_m2(self) -> float:
        """Area of the cells [m2]."""
        return len(self.eyes) * self.edge_m**2

    def way(self) -> Float64:
        """Return viewpoints (V, 3), in the order of a way: along its longest branch first."""
        reaches = _spread(_graph(self.eyes, self.edge_m), self.clearance)
        parents, children = _tree(reaches)
        way = [self.eyes[[reaches[0].start]]]
        for node in _longest_first(children):
            if node:
                way.append(self._steps(reaches[parents[node]], reaches[node]))
        return np.concatenate(way)

    def _steps(self, before: _Reach, after: _Reach) -> Float64:
        """Return the viewpoints from one place to another, without the first."""
        if after.start in before:
            cells = before.path(after.start)
        else:
            cells = after.path(before.start)[::-1]
        count = max(1, math.ceil((len(cells) - 1) * self.edge_m / STEP_M))
        steps = np.linspace(0, len(cells) - 1, count + 1).round().astype(int)[1:]
        viewpoints: Float64 = self.eyes[np.array(cells)[steps]]
        return viewpoints


@dataclass(frozen=True)
class _Reach:
    """Cells near one, over the floor.

    Attributes
    ----------
    start : int
    cells : (K,) int64
        Sorted.
    distances : (K,) float64
        From the start [m].
    before : (K,) int64
        Cell before each on the shortest way from the start.
    """

    start: int
    cells: Int64
    distances: Float64
    before: Int64

    def __contains__(self, cell: int) -> bool:
        at = self._at(cell)
        return at < len(self.cells) and self.cells[at] == cell

    def _at(self, cell: int) -> int:
        return int(np.searchsorted(self.cells, cell))

    def path(self, cell: int) -> list[int]:
        """Return the cells from the start to one."""
        path = [cell]
        while path[-1] != self.start:
            path.append(int(self.before[self._at(path[-1])]))
        return path[::-1]


def free_floors(mesh: PlanMesh, sensor_height_m: float) -> list[Floor]:
    """Return the connected parts of the free floor of a plan, the lowest first.

    Parameters
    ----------
    mesh : PlanMesh
    sensor_height_m : float
        Height of the viewpoints over the floor.
    """
    places, edge = _floor(mesh, sensor_height_m + HEADROOM_M)
    legs = places + [0.0, 0.0, min(_LEGS_M, sensor_height_m)]
    places = places[_clearance(mesh, legs, 2 * _BESIDE_M) > _BESIDE_M]
    eyes = places + [0.0, 0.0, sensor_height_m]
    clearance = _clearance(mesh, eyes, MAX_CLEARANCE_M)
    eyes, clearance = eyes[clearance > _BESIDE_M], clearance[clearance > _BESIDE_M]
    if not len(eyes):
        return []
    _, label = connected_components(_graph(eyes, edge), directed=False)
    rows = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1])
    parts = [Floor(eyes[part], clearance[part], edge) for part in rows]
    parts = [part for part in parts if part.area_m2 >= _MIN_AREA_M2]
    return sorted(_in_rooms(parts, mesh), key=lambda part: float(np.median(part.eyes[:, 2])))


def storeys(floors: list[Floor]) -> Iterator[list[Floor]]:
    """Yield the floors of each storey, by their heights."""
    storey: list[Floor] = []
    for floor in floors:
        height = float(np.median(floor.eyes[:, 2]))
        if storey and height - float(np.median(storey[0].eyes[:, 2])) > STOREY_M:
            yield storey
            storey = []
        storey.append(floor)
    if storey:
        yield storey


def _floor(mesh: PlanMesh, headroom_m: float) -> tuple[Float64, float]:
    """Return the middle of each cell with level ground below free space, (N, 3), and their side.

    Rays go down through all surfaces of a column.
    """
    corners = mesh.triangles.reshape(-1, 3)
    low, high = corners.min(axis=0).astype(np.float64), corners.max(axis=0).astype(np.float64)
    edge = max(_CELL_M, math.sqrt(float(np.prod(high[:2] - low[:2])) / _MAX_COLUMNS))
    axes = [np.arange(a + edge / 2, b, edge) for a, b in zip(low[:2], high[:2], strict=True)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    above = np.full(len(xy), np.inf)  # height of the surface above
    at = np.full(len(xy), high[2] + 1.0)
    found = [np.empty((0, 3))]
    for _ in range(_MAX_LAYERS):
        if not len(xy):
            break
        down = np.array([[0.0, 0.0, -1.0]])
        ranges, hit = mesh.cast(np.column_stack([xy, at]), down, high[2] - low[2] + 2.0)
        met = hit >= 0
        xy, above, at, hit = xy[met], above[met], at[met] - ranges[met], hit[met]
        free = (np.abs(mesh.normals(hit)[:, 2]) > _LEVEL) & (above - at > headroom_m)
        found.append(np.column_stack([xy[free], at[free]]))
        above, at = at, at - _EPSILON_M
    return np.concatenate(found), edge


def _clearance(mesh: PlanMesh, eyes: Float64, most_m: float) -> Float64:
    """Return the distance to the next surface at the height of each eye [m], (N,)."""
    nearest = np.full(len(eyes), most_m)
    for direction in _around():
        np.minimum(nearest, mesh.cast(eyes, direction[None], most_m)[0], out=nearest)
    return nearest


def _in_rooms(parts: list[Floor], mesh: PlanMesh) -> list[Floor]:
    """Leave out roofs, and the insides of solids.

    These are told by their back faces, if most of the floor is in front of surfaces.
    """
    kept, inside = [], []
    for part in parts:
        directions = _around()
        _, hit = mesh.cast(part.eyes[[np.argmax(part.clearance)]], directions, _FAR_M)
        met = hit >= 0
        if met.mean() < _MIN_WALLS:
            continue
        facing = np.einsum("ij,ij->i", mesh.normals(hit[met]), directions[met])
        kept.append(part)
        inside.append((facing > 0).mean() > _INSIDE)
    area = np.array([part.area_m2 for part in kept])
    if area[inside].sum() > area.sum() / 2:
        return kept
    return [part for part, within in zip(kept, inside, strict=True) if not within]


def _around() -> Float64:
    """Return horizontal directions, (D, 3)."""
    angles = (np.arange(_DIRECTIONS) + 0.5) * (2 * math.pi / _DIRECTIONS)
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(_DIRECTIONS)])


def _graph(eyes: Float64, edge_m: float) -> csr_array:
    """Return the lengths of the steps between neighbouring cells, (N, N)."""
    scale = [edge_m, edge_m, _RISE_M]
    pairs = cKDTree(eyes / scale).query_pairs(1.001, p=np.inf, output_type="ndarray")
    lengths = np.linalg.norm(eyes[pairs[:, 0]] - eyes[pairs[:, 1]], axis=1)
    return coo_array((lengths, tuple(pairs.T)), shape=(len(eyes), len(eyes))).tocsr()


def _spread(graph: csr_array, clearance: Float64) -> list[_Reach]:
    """Choose cells near all others, the roomiest first; return what is near each."""
    found = []
    left = np.ones(len(clearance), bool)
    for cell in np.argsort(-clearance, kind="stable").tolist():
        if not left[cell]:
            continue
        radius = max(SPACING_M, float(clearance[cell]))
        distances, before = dijkstra(
            graph, directed=False, indices=cell, limit=2 * radius + 1, return_predecessors=True
        )
        near = np.flatnonzero(np.isfinite(distances))
        left[near[distances[near] <= radius]] = False
        found.append(_Reach(cell, near, distances[near], before[near].astype(np.int64)))
    return found


def _tree(reaches: list[_Reach]) -> tuple[list[int], list[list[int]]]:
    """Return parent and children of each place in the shortest tree, with the first as root."""
    starts = np.array([reach.start for reach in reaches])
    rows, columns, lengths = [], [], []
    for i, reach in enumerate(reaches):
        _, theirs, mine = np.intersect1d(starts, reach.cells, return_indices=True)
        others = theirs != i
        columns.append(theirs[others])
        lengths.append(reach.distances[mine[others]])
        rows.append(np.full(int(others.sum()), i))
    count = len(reaches)
    entries = np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))
    tree = minimum_spanning_tree(coo_array(entries, shape=(count, count)).tocsr()).tocoo()
    beside: list[list[int]] = [[] for _ in reaches]
    for i, j in zip(tree.row.tolist(), tree.col.tolist(), strict=True):
        beside[i].append(j)
        beside[j].append(i)
    parents, order = [-1] * count, [0]
    for node in order:
        for other in beside[node]:
            if other != parents[node]:
                parents[other] = node
                order.append(other)
    children: list[list[int]] = [[] for _ in reaches]
    for node in order[1:]:
        children[parents[node]].append(node)
    return parents, children


def _longest_first(children: list[list[int]]) -> Iterator[int]:
    """Yield the nodes of a tree from its root: after each the longest branch, then the others."""
    depth = [0] * len(children)
    order = [0]
    for node in order:
        order += children[node]
    for node in reversed(order):
        depth[node] = 1 + max((depth[child] for child in children[node]), default=0)
    left = [0]
    while left:
        node = left.pop()
        yield node
        left += sorted(children[node], key=lambda child: depth[child])
