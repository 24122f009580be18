"""Every native function refuses what it cannot use, or answers; a child that forks goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from samples import bindings

from segloc import _native

TESTS = Path(__file__).parent


def run(*command: str, timeout: float = 300.0) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, [str(TESTS), os.environ.get("PYTHONPATH", "")]))
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", *command],
        capture_output=True,
        text=True,
        timeout=timeout,
        env=environment,
        check=False,
    )


@pytest.fixture(scope="module")
def faults() -> dict[str, list[str]]:
    """Of each function, what is wrong; tried in a child, and after a crash the others in another.

    A crash is a failure of one test, not the end of all.
    """
    found: dict[str, list[str]] = {}
    left = list(bindings.NAMES)
    while left:
        done = run("-m", "samples.bindings", *left, timeout=900.0)
        lines = done.stdout.splitlines()
        for name in left:
            found[name] = [line for line in lines if line.startswith(f"FAULT {name} ")][:20]
        ended = [line.split()[1] for line in lines if line.startswith(f"{bindings.DONE} ")]
        left = left[len(ended) :]
        if left:
            found[left.pop(0)] += [*lines[-1:], f"status {done.returncode}", done.stderr[-3000:]]
    return found


@pytest.mark.fuzz
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", bindings.NAMES)
def test_arguments_are_refused_or_answered(name: str, faults: dict[str, list[str]]) -> None:
    assert not faults[name], "\n".join(faults[name])


def test_every_function_is_in_the_table() -> None:
    known = {name.split(".")[0] for name in bindings.NAMES}
    assert known == {name for name in dir(_native) if not name.startswith("_")}
    assert all(tuple(room()) for room in bindings.ROOMS)
    for name in bindings.NAMES:
        assert name in bindings.calls(name)


def test_coordinates_of_maps_lose_nothing() -> None:
    """UTM and ECEF coordinates, and a height grid of a centimetre at 10 000 km."""
    arguments = bindings._matches()
    options = (0.6, 1.0, 1.0, 3.0, 15.0, 16, 4, 1)
    for place in ([4.5e5, 5.4e6, 100.0], [-6.4e6, 6.3e6, 6.2e6], [1e7, -1e7, 0.0]):
        moved = {**arguments, "map": arguments["query"] + place}
        poses, inliers, _ = _native.consensus(*moved.values(), *options)
        assert inliers[0] > 50
        np.testing.assert_allclose(poses[0, :3, 3], place, atol=1e-3)
    flat = np.float32([[1e7, 1e7, 2.0], [1e7 + 1, 1e7, 2.5], [1e7, 1e7 + 1, 7.0]])
    heights = _native.heights_above_ground(flat, 0.01, 0.2, 0.3)
    assert np.isfinite(heights).all()
    assert (heights >= 0).all()


def test_threads_are_counted_once() -> None:
    assert _native.resolve_threads(3) == 3
    assert _native.resolve_threads(2**31 - 1) == 256
    assert 1 <= _native.resolve_threads(0) == _native.resolve_threads(-5) <= (os.cpu_count() or 1)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux alone binds processes")
def test_a_bound_process_uses_its_processors_only() -> None:
    code = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    code += "from segloc import _native; print(_native.resolve_threads(0))"
    assert run("-c", code).stdout.strip() == "1"


FORKS = """
import os, sys, threading, time
import numpy as np
from samples import bindings
from segloc import _native
a = list(bindings._matches(200).values())
def find(threads):
    return _native.consensus(*a, 0.6, 1.0, 1.0, 3.0, 15.0, 16, 4, threads)[0].tobytes()
expected, stop = find(2), threading.Event()
def go_on():
    while not stop.is_set(): find(2)
others = [threading.Thread(target=go_on) for _ in range(2)]
for t in others: t.start()
for k in range(10):
    child = os.fork()
    if child == 0: os._exit(0 if find(2) == expected and find(3) == expected else 1)
    end = time.monotonic() + 20
    while (done := os.waitpid(child, os.WNOHANG))[0] == 0:
        if time.monotonic() > end:
            os.kill(child, 9); os._exit(3)
        time.sleep(0.002)
    if done[1]: os._exit(2)
stop.set()
for t in others: t.join()
assert find(2) == expected
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.skipif(
    "asan" in os.environ.get("LD_PRELOAD", ""), reason="the sanitizer's own locks are inherited"
)
def test_children_compute_while_the_parent_does() -> None:
    """The pool's threads and locks are not inherited: a child makes its own."""
    done = run("-W", "ignore::DeprecationWarning", "-c", FORKS, timeout=120.0)
    assert done.returncode == 0, (done.returncode, done.stderr)
