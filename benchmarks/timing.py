"""Best wall time of several runs, and a table of rivals."""

from __future__ import annotations

import time
from collections.abc import Callable


def best_ms(run: Callable[[], object], repeats: int) -> float:
    """The shortest of some runs, in milliseconds: what the machine can do undisturbed."""
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


def table(title: str, ours: dict[str, float], rivals: dict[str, float]) -> None:
    """Print our times and, for each rival, how many times longer it takes than each of ours."""
    print(f"\n{title}")
    for name, ms in ours.items():
        print(f"  segloc {name:<28} {ms:10.2f} ms")
    for name, ms in rivals.items():
        ratios = "  ".join(f"{ms / own:6.1f}x {label}" for label, own in ours.items())
        print(f"  {name:<35} {ms:10.2f} ms  {ratios}")


def instruction_sets() -> list[str]:
    """Those that this machine runs."""
    from segloc import _native

    found = []
    for isa in ("portable", "avx2", "avx512"):
        try:
            found.append(_native.instruction_set(isa))
        except ValueError:
            continue
    return found
