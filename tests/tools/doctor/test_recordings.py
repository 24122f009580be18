"""Real recordings: what the doctor finds in each, and nothing else."""

from __future__ import annotations

import pytest
from samples.real import real

from segloc.tools.datasets import open_sequence
from segloc.tools.doctor import Examination, Fault, examine

UNPOSED = {Fault.NO_POSES}
SHOWS_LITTLE = {Fault.FEW_BEAMS}
SWAYS = {Fault.TILT}
TILTED = {Fault.POSES_TILTED}
LEFT_OUT = {Fault.READING}
NO_GROUND = {Fault.NO_GROUND}
ON_ROBOT = {Fault.BODY_IN_VIEW}
HEALTHY: set[Fault] = set()
STARTS = [f"kitti_starts/{place:02d}_0.laz" for place in (1, 4, 7, 10)]

NOTES: list[tuple[str, str | None, set[Fault]]] = [
    ("kitti00/keyframes", None, UNPOSED | SWAYS),
    ("kitti00/keyframes", "kitti00/keyframes.tum", {Fault.PASSES_APART}),  # by 0.7 m
    ("kitti00/scans", "kitti00/scans.tum", HEALTHY),
    ("pair_kitti00", "pair_kitti00/poses.tum", TILTED),
    ("hdl64_drive", None, UNPOSED),
    ("hdl32e", None, UNPOSED | SWAYS | ON_ROBOT),
    ("vlp16", None, SHOWS_LITTLE | SWAYS | ON_ROBOT),
    ("vlp16_corridor/scans", None, SHOWS_LITTLE | ON_ROBOT),
    ("vlp16_corridor/scans", "vlp16_corridor/poses.tum", ON_ROBOT),
    ("vlp16_narrow_corridor/scans", None, SHOWS_LITTLE | SWAYS),
    ("vlp16_narrow_corridor/scans", "vlp16_narrow_corridor/poses.tum", HEALTHY),
    ("mid360_lab/0618/scans", None, UNPOSED),
    ("mid360_lab/0622a/scans", "mid360_lab/0622a/poses.tum", TILTED),
    ("mid360_lab/0622b/scans", "mid360_lab/0622b/poses_own_frame.tum", HEALTHY),
    ("robosense_e1r_indoor/scans", None, UNPOSED | SWAYS),
    ("robosense_e1r_indoor/scans", "robosense_e1r_indoor/poses.tum", HEALTHY),
    ("utd_grand_loop/scans", None, UNPOSED | NO_GROUND | SWAYS),
    ("utd_grand_loop/scans", "utd_grand_loop/poses.tum", NO_GROUND),
    ("utd_grand_loop/scans", "utd_grand_loop/poses_registered.tum", NO_GROUND | LEFT_OUT),
    *((start, None, UNPOSED) for start in STARTS),
    ("formats/car_cloud400.csv", None, UNPOSED | SWAYS),
    ("formats/cloud.00000.vtk", None, UNPOSED),
    ("formats/hdl32e_binary_with_ring.pcd", None, UNPOSED),
    ("formats/hdl64_intensity.pcd", None, UNPOSED),
    ("formats/kitti_000000.bin", None, UNPOSED),
    ("formats/source_binary.ply", None, UNPOSED | SWAYS | {Fault.MISSING_RETURNS}),
    ("formats/vlp16_ascii.pcd", None, SHOWS_LITTLE),
    ("formats_found/vlp32c_invalid_as_0.1.pcd", None, UNPOSED | SWAYS | {Fault.MISSING_RETURNS}),
    ("formats_found/width0_points0_header.pcd", None, UNPOSED),
    ("formats_more/cloud_1690309709_285305600.vtk", None, UNPOSED),
    ("formats_more/ouster/512x10_raw.bag", None, UNPOSED),
]
"""Recording, its poses, and the remarks on it: none of these has a fault."""

WRONG: list[tuple[str, str | None, Fault, str]] = [
    (
        "mid360_lab/0622a/scans",
        "mid360_lab/0622a/poses_own_frame.tum",
        Fault.POSES_TILTED,
        "frame of the poses is tilted",
    ),
    ("cross_sensor_places/pjlab_0001/scans", None, Fault.READING, "another sensor from"),
]
"""Recordings with a real fault: a frame that is tilted, and several sensors in one folder."""

pytestmark = [pytest.mark.data, pytest.mark.slow]


@pytest.mark.parametrize(("name", "poses", "expected"), NOTES)
def test_real_recordings_have_remarks_at_most(
    name: str, poses: str | None, expected: set[Fault]
) -> None:
    found = _examined(name, poses)
    lines = [str(finding) for finding in found.findings]
    assert found.healthy, lines
    assert {finding.fault for finding in found.findings} == expected, lines


@pytest.mark.parametrize(("name", "poses", "fault", "what"), WRONG)
def test_real_faults_are_named(name: str, poses: str | None, fault: Fault, what: str) -> None:
    wrong = [finding for finding in _examined(name, poses).findings if finding.wrong]
    assert {finding.fault for finding in wrong} == {fault}
    assert any(what in str(finding) for finding in wrong)


def _examined(name: str, poses: str | None) -> Examination:
    pytest.importorskip("laspy")
    file = None if poses is None else real(*poses.split("/"))
    return examine(open_sequence(real(*name.split("/")), file))
