"""How far a share that was counted may be from the true one, and whether two shares differ."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.stats import binomtest


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's score interval of a share at 95 %; (0, 1) of no trials."""
    if not trials:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def share(successes: int, trials: int) -> str:
    """A count with its interval in percent, as "8 of 10 (49 to 94 %)"."""
    low, high = wilson(successes, trials)
    digits = 0 if trials < 200 else 1
    interval = f" ({100 * low:.{digits}f} to {100 * high:.{digits}f} %)" if trials else ""
    return f"{successes} of {trials}{interval}"


def apart(a: Sequence[bool], b: Sequence[bool]) -> tuple[int, int]:
    """How often the first alone succeeded, and the second alone, of the same queries.

    Raises
    ------
    ValueError
        If they are not of the same queries.
    """
    pairs = list(zip(a, b, strict=True))
    return sum(x and not y for x, y in pairs), sum(y and not x for x, y in pairs)


def mcnemar(a: Sequence[bool], b: Sequence[bool]) -> float:
    """McNemar's exact test: how likely two methods that are equally good differ so much.

    Parameters
    ----------
    a, b : sequences of bool
        Whether each method succeeded, query by query, in the same order.

    Returns
    -------
    float
        Two-sided p-value; 1 where no query tells them apart.

    Raises
    ------
    ValueError
        If they are not of the same queries.
    """
    only_a, only_b = apart(a, b)
    if not only_a + only_b:
        return 1.0
    return float(binomtest(only_a, only_a + only_b, 0.5).pvalue)
