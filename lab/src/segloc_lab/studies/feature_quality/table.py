"""What was found, as tables: FC4 against plain distance, the mean over domains and for each.

    python -m segloc_lab.studies.feature_quality.table RESULTS.json [RESULTS.json ...]

RESULTS are what ``feature_quality.train`` wrote. A cell is the difference of areas under the ROC
with its 95 % interval, over seeds and places; first where training and test are of one domain, then
where they are not, and on real scans, which were never trained on.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...script import head, parser, row
from .areas import gain

REAL = "kitti00"


def main() -> None:
    options = parser(__doc__)
    options.add_argument("results", type=Path, nargs="+")
    given = options.parse_args()
    found = [json.loads(path.read_text("utf-8")) for path in given.results]
    for network in dict.fromkeys(each["network"] for each in found):
        mine = [each for each in found if each["network"] == network]
        print(f"\n{network}: {', '.join(_described(each) for each in mine)}\n")
        _any_pairs(mine)
        print()
        _candidates(mine)


def _described(result: dict[str, Any]) -> str:
    return f"{result['domain']} ({result['steps']} steps, {result['seeds']} seeds)"


def _any_pairs(results: Sequence[dict[str, Any]]) -> None:
    columns = [f"{r['domain']} on itself" for r in results] + [
        f"{r['domain']} on real" for r in results
    ]
    print(head("any pairs", *columns, "on others, mean"))
    rows = [(r, r["domain"]) for r in results] + [(r, REAL) for r in results]
    plain = [f"{r['tests'][test]['any']['distance alone']['area']:.4f}" for r, test in rows]
    print(row("area by distance", *plain, ""))
    for judge in results[0]["tests"][REAL]["any"]:
        if judge != "distance alone":
            cells = [_cell(r["tests"][test]["any"][judge]) for r, test in rows]
            others = [r["tests"][t]["any"][judge] for r, t in _others(results)]
            mean = np.mean([each["difference"]["mean"] for each in others])
            print(row(judge, *cells, f"{mean:+.4f}"))


def _others(results: Sequence[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], str]]:
    for result in results:
        for test in result["tests"]:
            if test not in (REAL, result["domain"]):
                yield result, test


def _cell(found: dict[str, Any]) -> str:
    return gain(found.get("against alone", found["difference"]))


def _candidates(results: Sequence[dict[str, Any]]) -> None:
    """How the candidates of a map are ordered, areas and shares of right ones."""
    columns = [f"{r['domain']} on {test}" for test in ("itself", "real") for r in results]
    print(head("area; right of the first 1 % of the candidates", *columns))
    for judge in results[0]["tests"][REAL]["nearest"]:
        cells = []
        for test in (None, REAL):
            for r in results:
                own = r["tests"][test or r["domain"]]["nearest"][judge]
                cells.append(f"{own['area']:.3f}; {own['top 0.01']:.3f}")
        print(row(judge, *cells))


if __name__ == "__main__":
    main()
