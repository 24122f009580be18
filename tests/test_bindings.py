"""Every native function refuses what it cannot use, or answers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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
    for table, names in bindings.ROOMS.items():
        assert tuple(dict(table())) == names


def test_threads_are_counted_once() -> None:
    assert _native.resolve_threads(3) == 3
    assert _native.resolve_threads(2**31 - 1) == 256
    assert 1 <= _native.resolve_threads(0) == _native.resolve_threads(-5) <= (os.cpu_count() or 1)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux alone binds processes")
def test_a_bound_process_uses_its_processors_only() -> None:
    code = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    code += "from segloc import _native; print(_native.resolve_threads(0))"
    assert run("-c", code).stdout.strip() == "1"
