"""Robust optimisation of a pose graph: sparse Gauss-Newton on rotations and positions.

Poses are perturbed as ``R <- R Exp(a)``, ``t <- t + R b``; vectors of six are rotation, then
translation, in the frame of the pose that moves. Loops are weighed by graduated non-convexity
with the Geman-McClure kernel: H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated
Non-Convexity for Robust Spatial Perception", RA-L 2020, Section IV-B.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from ..types import Float64, Int64

CHI2_6 = 16.81
"""99 % quantile of the squared residual of a correct loop."""

_KERNEL = CHI2_6 / (np.sqrt(2.0) - 1.0)  # the weight at CHI2_6 is 1/2
_COOLING = 1.6
_STEPS = 3


@dataclass(frozen=True)
class Edges:
    """Measured relative poses of E edges.

    Attributes
    ----------
    first, second : (E,) int64
        Nodes.
    T : (E, 4, 4) float64
        T_first_second.
    covariance : (E, 6, 6) float64
        Of rotation [rad] and translation [m], in the frame of ``second``.
    """

    first: Int64
    second: Int64
    T: Float64
    covariance: Float64

    def __len__(self) -> int:
        return len(self.first)

    def whitening(self) -> Float64:
        """Return W (E, 6, 6) with the information matrix ``W^T W``."""
        lower = np.linalg.cholesky(np.linalg.inv(self.covariance))
        return np.ascontiguousarray(lower.transpose(0, 2, 1))


def concatenate_edges(parts: list[Edges]) -> Edges:
    """Return the edges of all parts, in order."""
    names = ("first", "second", "T", "covariance")
    return Edges(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def residuals(poses: Float64, edges: Edges) -> Float64:
    """Return the residual of each edge (E, 6): rotation vector [rad] and translation [m]."""
    A, B = poses[edges.first], poses[edges.second]
    RzT = edges.T[:, :3, :3].transpose(0, 2, 1)
    RaT = A[:, :3, :3].transpose(0, 2, 1)
    between = np.einsum("nij,nj->ni", RaT, B[:, :3, 3] - A[:, :3, 3])
    turn = Rotation.from_matrix(RzT @ RaT @ B[:, :3, :3]).as_rotvec()
    shift = np.einsum("nij,nj->ni", RzT, between - edges.T[:, :3, 3])
    return np.concatenate([turn, shift], axis=1)


def squared_errors(poses: Float64, edges: Edges) -> Float64:
    """Return the squared Mahalanobis length of each residual, (E,)."""
    whitened = np.einsum("nij,nj->ni", edges.whitening(), residuals(poses, edges))
    squares: Float64 = np.square(whitened).sum(axis=1)
    return squares


def jacobians(poses: Float64, edges: Edges) -> tuple[Float64, Float64]:
    """Return derivatives of :func:`residuals` by the first and the second pose, (E, 6, 6) each."""
    A, B = poses[edges.first], poses[edges.second]
    RzT = edges.T[:, :3, :3].transpose(0, 2, 1)
    RaT = A[:, :3, :3].transpose(0, 2, 1)
    Rab = RaT @ B[:, :3, :3]
    between = np.einsum("nij,nj->ni", RaT, B[:, :3, 3] - A[:, :3, 3])
    inverse = _inverse_right_jacobian(Rotation.from_matrix(RzT @ Rab).as_rotvec())
    first = np.zeros((len(edges), 6, 6))
    second = np.zeros((len(edges), 6, 6))
    first[:, :3, :3] = -inverse @ Rab.transpose(0, 2, 1)
    first[:, 3:, :3] = RzT @ _cross(between)
    first[:, 3:, 3:] = -RzT
    second[:, :3, :3] = inverse
    second[:, 3:, 3:] = RzT @ Rab
    return first, second


def perturb(poses: Float64, steps: Float64) -> Float64:
    """Perturb poses (N, 4, 4) by rotations and translations (N, 6)."""
    result: Float64 = poses.copy()
    R = poses[:, :3, :3]
    result[:, :3, :3] = R @ Rotation.from_rotvec(steps[:, :3]).as_matrix()
    result[:, :3, 3] += np.einsum("nij,nj->ni", R, steps[:, 3:])
    return result


def solve(
    poses: Float64, edges: Edges, weights: Float64, fixed: Int64, *, steps: int = 30
) -> Float64:
    """Minimise the weighted squared residuals by Levenberg-Marquardt.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        Initial poses; each must be connected to a node of ``fixed``.
    edges : Edges
    weights : (E,) float64
    fixed : (F,) int64
        Nodes that are not moved.
    steps : int
        Maximum number of iterations.
    """
    if not len(edges):
        return poses
    whitening = edges.whitening() * np.sqrt(weights)[:, None, None]
    free = np.setdiff1d(np.arange(len(poses)), fixed)
    cost, damping = _cost(poses, edges, whitening), 1e-6
    for _ in range(steps):
        H, g = _normal_equations(poses, edges, whitening, free)
        trial, trial_cost = poses, np.inf
        while damping < 1e6:
            step = np.zeros((len(poses), 6))
            damped = (H + damping * sparse.diags(H.diagonal())).tocsc()
            step[free] = splu(damped, permc_spec="MMD_AT_PLUS_A").solve(-g).reshape(-1, 6)
            trial = perturb(poses, step)
            trial_cost = _cost(trial, edges, whitening)
            if trial_cost <= cost:
                break
            damping *= 10.0
        if not trial_cost <= cost:
            break
        gained, poses, cost = cost - trial_cost, trial, trial_cost
        damping = max(damping / 10.0, 1e-9)
        if gained <= 1e-7 * max(cost, 1.0):
            break
    return poses


def solve_robustly(
    poses: Float64, edges: Edges, loops: NDArray[np.bool_], fixed: Int64
) -> tuple[Float64, Float64]:
    """Optimise poses and the weight of each edge, (E,) in [0, 1]; 1 for odometry.

    Starts from the convex problem with all loops, then lowers the weights of outliers step by step,
    so that large drift rejects no correct loop.
    """
    weights = np.ones(len(edges))
    poses = solve(poses, edges, weights, fixed)
    if not loops.any():
        return poses, weights
    squares = squared_errors(poses, edges)
    mu = max(1.0, 2.0 * float(squares[loops].max()) / _KERNEL)
    while True:
        weights[loops] = _weights(squared_errors(poses, edges)[loops], mu)
        poses = solve(poses, edges, weights, fixed, steps=_STEPS if mu > 1 else 30)
        if mu <= 1.0:
            break
        mu = max(1.0, mu / _COOLING)
    weights[loops] = _weights(squared_errors(poses, edges)[loops], 1.0)
    return poses, weights


def _weights(squares: Float64, mu: float) -> Float64:
    weights: Float64 = np.square(mu * _KERNEL / (squares + mu * _KERNEL))
    return weights


def _cost(poses: Float64, edges: Edges, whitening: Float64) -> float:
    whitened = np.einsum("nij,nj->ni", whitening, residuals(poses, edges))
    return float(np.square(whitened).sum())


def _normal_equations(
    poses: Float64, edges: Edges, whitening: Float64, free: Int64
) -> tuple[Any, Float64]:
    first, second = jacobians(poses, edges)
    error = np.einsum("nij,nj->ni", whitening, residuals(poses, edges))
    blocks = np.stack([whitening @ first, whitening @ second], axis=1)  # (E, 2, 6, 6)
    nodes = np.stack([edges.first, edges.second], axis=1)
    inner = np.arange(6)
    columns = np.broadcast_to((6 * nodes)[:, :, None, None] + inner, blocks.shape)
    rows = np.broadcast_to(
        (6 * np.arange(len(edges)))[:, None, None, None] + inner[:, None], blocks.shape
    )
    shape = (6 * len(edges), 6 * len(poses))
    J = sparse.csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    J = J[:, (6 * free[:, None] + inner).ravel()]
    return (J.T @ J).tocsc(), np.asarray(J.T @ error.ravel(), dtype=np.float64)


def _cross(v: Float64) -> Float64:
    """Return the cross-product matrices (N, 3, 3) of vectors (N, 3)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    matrices: Float64 = np.array(rows, dtype=np.float64).transpose(2, 0, 1)
    return matrices


def _inverse_right_jacobian(turn: Float64) -> Float64:
    """Inverse right Jacobian of SO(3) at (N, 3); Solà et al., arXiv 1812.01537, equation 144."""
    angle = np.linalg.norm(turn, axis=1)
    safe = np.maximum(angle, 1e-4)
    share = np.where(
        angle < 1e-4, 1 / 12, 1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.sin(safe))
    )
    skew = _cross(turn)
    result: Float64 = np.eye(3) + skew / 2 + share[:, None, None] * (skew @ skew)
    return result
