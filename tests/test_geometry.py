"""Covariances in ROS's order and frame, against finite differences."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from segloc import geometry, ros_covariance
from segloc.types import Float64, Pose


def perturbed(T: Pose, delta: Float64) -> Pose:
    """The pose moved by a small rotation and translation in the sensor's own frame."""
    R = Rotation.from_rotvec(delta[:3]).as_matrix()
    return T @ geometry.rigid(R, delta[3:])


def ros_vector(T: Pose, T_moved: Pose) -> Float64:
    """x, y, z and the rotation about the map's fixed axes, from one pose to another."""
    turn = Rotation.from_matrix(T_moved[:3, :3] @ T[:3, :3].T).as_rotvec()
    return np.concatenate([T_moved[:3, 3] - T[:3, 3], turn])


def test_covariance_as_ros_has_it_by_finite_differences() -> None:
    rng = np.random.default_rng(0)
    T = geometry.rigid(
        Rotation.from_rotvec([0.4, -0.7, 2.0]).as_matrix(), np.array([9.0, 8.0, 7.0])
    )
    root = rng.normal(size=(6, 6)) * 1e-2
    covariance = root @ root.T
    step = 1e-7
    columns = [ros_vector(T, perturbed(T, step * axis)) / step for axis in np.eye(6)]
    J = np.stack(columns, axis=1)
    np.testing.assert_allclose(ros_covariance(covariance, T), J @ covariance @ J.T, atol=1e-9)


def test_covariance_in_another_frame_by_finite_differences() -> None:
    """A local frame and a sensor that share their origin."""
    T_local_sensor = geometry.rigid(Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix(), np.zeros(3))
    T_map_local = geometry.yaw_transform(1.0, (5.0, 6.0, 7.0))
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * 1e-2
    covariance, step = root @ root.T, 1e-7
    T = T_map_local @ T_local_sensor

    def column(axis: Float64) -> Float64:
        moved = perturbed(T_map_local, step * axis) @ T_local_sensor
        delta = geometry.inverse(T) @ moved
        turn = Rotation.from_matrix(delta[:3, :3]).as_rotvec()
        return np.concatenate([turn, delta[:3, 3]]) / step

    J = np.stack([column(axis) for axis in np.eye(6)], axis=1)
    rotated = geometry.rotated_covariance(covariance, T_local_sensor)
    np.testing.assert_allclose(rotated, J @ covariance @ J.T, atol=1e-9)


def test_poses_are_apart_by_distance_by_heading_or_by_storey() -> None:
    separation = geometry.Separation()
    here = geometry.yaw_transform(0.0)
    assert not separation.apart(here, geometry.yaw_transform(0.2, (2.0, 2.0, 1.9)))
    assert separation.apart(here, geometry.yaw_transform(0.0, (0.0, 0.0, -2.1)))
    assert separation.apart(here, geometry.yaw_transform(0.0, (2.2, 2.2, 0.0)))
    assert separation.apart(here, geometry.yaw_transform(0.3))
