"""One localizer, used by many threads and processes at once."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from samples.maps import make_map
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, Localization, Localizer, Scan, SegmentMap, build_map, geometry

PROFILE = Config.preset("profile")
YAWS = (0.3, 1.0, 2.0, -2.0)


@pytest.fixture(scope="module")
def localizer(plaza: Plaza) -> Localizer:
    return Localizer(build_map(PlazaSequence(plaza, steps=6), PROFILE))


@pytest.fixture(scope="module")
def scans(plaza: Plaza) -> list[Scan]:
    return [plaza.scan(geometry.yaw_transform(yaw, (-8.0, 1.0, 1.7))) for yaw in YAWS]


def bits(result: Localization) -> bytes:
    T = np.zeros((4, 4)) if result.T_map_sensor is None else result.T_map_sensor
    return T.tobytes() + np.float64(result.confidence).tobytes()


@pytest.mark.slow
def test_threads_share_a_localizer(localizer: Localizer, scans: list[Scan]) -> None:
    expected = [bits(localizer.localize(scan)) for scan in scans]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: bits(localizer.localize(scans[k % 4])), range(16)))
    assert found == [expected[k % 4] for k in range(16)]


def localized(work: tuple[Localizer, Scan]) -> bytes:
    return bits(work[0].localize(work[1]))


@pytest.mark.slow
def test_spawned_processes_localize(localizer: Localizer, scans: list[Scan]) -> None:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        found = list(pool.map(localized, [(localizer, scan) for scan in scans[:2]]))
    assert found == [bits(localizer.localize(scan)) for scan in scans[:2]]


FORK = """
import os, sys, threading, warnings
sys.path[:0] = {path!r}
warnings.simplefilter("ignore")
from samples.maps import make_map
from samples.plaza import Plaza, PlazaSequence
from segloc import Config, Localizer, build_map, geometry
from segloc.proposals.first_sight import FirstSightConfig
plaza = Plaza(0)
late = FirstSightConfig(enabled=False)  # descriptors are computed, too
config = Config.preset("profile")  # with a pool in each process
config = config.model_copy(update={{"threads": 2, "first_sight": late}})
localizer = Localizer(build_map(PlazaSequence(plaza, steps=3), config), config)
scan = plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)))
expected = localizer.localize(scan).T_map_sensor.tobytes()
stop = threading.Event()
def busy():
    while not stop.is_set():
        localizer.localize(scan)
threads = [threading.Thread(target=busy) for _ in range(2)]
for thread in threads: thread.start()
status = []
for _ in range(4):
    child = os.fork()
    if child == 0:
        same = localizer.localize(scan).T_map_sensor.tobytes() == expected
        os._exit(0 if same else 3)
    status.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
stop.set()
for thread in threads: thread.join()
print(status)
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_fork_while_other_threads_localize_does_not_hang() -> None:
    code = FORK.format(path=[path for path in sys.path if path])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str([0] * 4)


def test_queries_change_nothing(localizer: Localizer, scans: list[Scan]) -> None:
    before = pickle.dumps(localizer.prior_map)
    points = [scan.points.copy() for scan in scans]
    for scan in scans:
        localizer.localize(scan)
    assert pickle.dumps(localizer.prior_map) == before
    for scan, kept in zip(scans, points, strict=True):
        np.testing.assert_array_equal(scan.points, kept)
    assert threading.active_count() < 50


def test_what_threads_join_at_once_is_whole() -> None:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            for _ in range(200):
                growing, together = make_map(views=6, segments=1), threading.Barrier(4)
                read = [pool.submit(lengths, growing, together) for _ in range(4)]
                points = len(make_map(views=6, segments=1).cloud)
                assert {each.result() for each in read} == {(6,) * 7 + (points,)}
    finally:
        sys.setswitchinterval(interval)


def lengths(growing: SegmentMap, together: threading.Barrier) -> tuple[int, ...]:
    together.wait()
    points = len(growing.cloud)
    return *(len(column) for column in growing.columns().values()), points
