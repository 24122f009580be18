"""Compare the corpus with its stored answers, or store them anew."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import platform
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .doors import instruction_set
from .recordings import GROUPS
from .records import Record

ANSWERS = Path(__file__).with_name("answers")
MAX_M, MAX_DEG, MIN_SHARE = 0.05, 0.3, 0.95
"""Where arithmetic may differ: of poses, and the share of cases that must be answered alike."""


def processor() -> dict[str, str]:
    """What bits may depend on: the instruction set chosen at run time, and the libraries."""
    vendor = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [line for line in info.read_text().splitlines() if line.startswith("vendor_id")]
        vendor += f" {lines[0].split()[-1]}" if lines else ""
    chosen = instruction_set("auto")
    libraries = {name: version(name) for name in ("numpy", "scipy", "embreex")}
    return {
        "processor": vendor,
        "instructions": chosen,
        "libc": platform.libc_ver()[1],
        **libraries,
    }


@dataclass(frozen=True)
class Difference:
    """A field of a case that is not as stored."""

    case: str
    field: str
    stored: Any
    found: Any

    def __str__(self) -> str:
        return f"    {self.case}: {self.field}: stored {self.stored}, found {self.found}"


@dataclass(frozen=True)
class Comparison:
    """How cases compare with those stored; ``off`` are differences where arithmetic may differ."""

    exact: int
    loose: int
    differences: list[Difference]
    off: list[Difference]

    @property
    def same(self) -> bool:
        return not self.differences and len(self.off) <= (1 - MIN_SHARE) * self.loose

    def __add__(self, other: Comparison) -> Comparison:
        differences, off = self.differences + other.differences, self.off + other.off
        return Comparison(self.exact + other.exact, self.loose + other.loose, differences, off)

    def __str__(self) -> str:
        return "\n".join(map(str, self.differences + self.off))


def compare(
    stored: dict[str, Record], found: dict[str, Record], same_processor: bool
) -> Comparison:
    """Compare bit for bit where processor and inputs are the same, else loosely."""
    differences, off, loose = [], [], 0
    for case in [*stored, *(name for name in found if name not in stored)]:
        before, now = stored.get(case), found.get(case)
        if before is None or now is None:
            state = ["missing" if each is None else "there" for each in (before, now)]
            differences.append(Difference(case, "case", *state))
        elif same_processor and before.get("inputs") == now.get("inputs"):
            differences += _exact(case, before, now)
        else:
            loose += 1
            off += _loose(case, before, now)
    return Comparison(len(found) - loose, loose, differences, off)


def _exact(case: str, before: Record, now: Record) -> Iterator[Difference]:
    for name in [*before, *(name for name in now if name not in before)]:
        if json.dumps(before.get(name)) != json.dumps(now.get(name)):
            yield Difference(case, name, before.get(name), now.get(name))


def _loose(case: str, before: Record, now: Record) -> list[Difference]:
    """The first of what must agree anywhere: whether and why, and about where."""
    for name in ("localized", "reason", "status", "accepted"):
        if before.get(name) != now.get(name):
            return [Difference(case, name, before.get(name), now.get(name))]
    a, b = before.get("pose"), now.get("pose")
    if (a is None) != (b is None) or (a is not None and _apart(a, b)):
        return [Difference(case, "pose", a, b)]
    return []


def _apart(a: list[float], b: list[float]) -> bool:
    turns = [Rotation.from_euler("xyz", each[3:], degrees=True) for each in (a, b)]
    turned = np.degrees((turns[0].inv() * turns[1]).magnitude())
    return bool(np.linalg.norm(np.subtract(a, b)[:3]) > MAX_M or turned > MAX_DEG)


# --- files ---------------------------------------------------------------------------------


def load(name: str) -> dict[str, Any]:
    """The stored answers of a group: ``recorded_on`` and ``cases``."""
    path = ANSWERS / f"{name}.json"
    stored: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {"cases": {}}
    return stored


def save(name: str, cases: dict[str, Record]) -> None:
    """Store the answers of a group, one line a case."""
    lines = [f"  {json.dumps(case)}: {json.dumps(record)}" for case, record in cases.items()]
    head = f'{{"recorded_on": {json.dumps(processor())},\n "cases": {{\n'
    (ANSWERS / f"{name}.json").write_text(head + ",\n".join(lines) + "\n}}\n")


# --- running -------------------------------------------------------------------------------


def answers(name: str) -> tuple[dict[str, Record], float]:
    """The cases of a group as they are now, and the processor time that they took, seconds."""
    start = time.process_time()
    cases: dict[str, Record] = {}
    for case, record in GROUPS[name].cases():
        assert case not in cases, f"{name}: two cases are named {case!r}"
        cases[case] = json.loads(json.dumps(record))
    return cases, time.process_time() - start


def check(name: str, cases: dict[str, Record]) -> Comparison:
    """Compare the cases of a group with those stored."""
    stored = load(name)
    return compare(stored["cases"], cases, stored.get("recorded_on") == processor())


def main() -> None:
    """Compare groups, print a line for each and every difference; status 1 if there is any."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("groups", nargs="*", metavar="GROUP", help="by default all")
    options.add_argument("--accept", action="store_true", help="store the answers of today")
    options.add_argument("--workers", type=int, default=2)
    args = options.parse_args()
    if unknown := sorted(set(args.groups) - set(GROUPS)):
        options.error(f"no such group: {', '.join(unknown)}; there are {', '.join(GROUPS)}")
    context = multiprocessing.get_context("spawn")
    failed, whole = False, Comparison(0, 0, [], [])
    with ProcessPoolExecutor(args.workers, mp_context=context) as pool:
        running = {pool.submit(answers, name): name for name in args.groups or GROUPS}
        for done in as_completed(running):
            name = running[done]
            if error := done.exception():
                failed = True
                print(f"{name}: failed: {type(error).__name__}: {error}", flush=True)
                continue
            cases, seconds = done.result()
            if args.accept:
                save(name, cases)
                print(f"{name}: {len(cases)} cases stored ({seconds:.0f} s)", flush=True)
                continue
            compared = check(name, cases)
            whole += compared
            how = "bit for bit" if not compared.loose else f"{compared.loose} of them loosely"
            count = len(compared.differences + compared.off)
            state = f"{count} differences" if count else "same"
            print(f"{name}: {len(cases)} cases, {how}: {state} ({seconds:.0f} s)", flush=True)
            if count:
                print(compared, flush=True)
    sys.exit(int(failed or not whole.same))
