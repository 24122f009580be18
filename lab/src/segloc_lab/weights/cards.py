"""What the cards of the shipped weights say: data, commit, and figures of held-out worlds.

python -m segloc_lab.weights.cards --store docs/results
"""

from __future__ import annotations

import json
from typing import Any

from segloc.descriptors.weightfile import shipped_weights
from segloc.system.tensor_file import opened

from ..results.store import Cell, Result
from ..script import storing

NETWORKS = ("profile", "dsm", "esm", "segmap")
FORESTS = ("segmatch-eigen", "segmatch-esf", "nsm")
COMMAND = "python -m segloc_lab.weights.cards --store docs/results"
EARLIER = "not named"
TRAINED = ("at commit", "training segments")


def card(name: str) -> dict[str, Any]:
    """What a shipped file says of how it was made."""
    with opened(shipped_weights(f"{name}.safetensors")) as file:
        found: dict[str, Any] = json.loads(file.metadata["card"])
    return found


def networks() -> Result:
    """Of each network: the step that was kept, and how well it knew segments again."""
    columns = (
        *("network", *TRAINED, "kept after steps", "validation segments"),
        *("validation area", "recall@25", "recall@1"),
    )
    figures = (
        *("steps", "validation segments", "validation auc"),
        *("validation recall", "validation recall_first"),
    )
    rows = [_row(name, card(name), figures) for name in NETWORKS]
    return Result.measured("networks", COMMAND, columns, rows, stages=(), methods=NETWORKS)


def forests() -> Result:
    """Of each forest: how well it tells right candidates from wrong ones."""
    columns = (
        *("forest", *TRAINED, "validation segments", "ROC area over candidates"),
        *("right ones kept", "wrong ones kept"),
    )
    figures = ("validation segments", "auc", "right_kept", "wrong_kept")
    rows = [_row(name, card(f"{name}-forest"), figures) for name in FORESTS]
    return Result.measured("forests", COMMAND, columns, rows, stages=(), methods=FORESTS)


def _row(name: str, found: dict[str, Any], figures: tuple[str, ...]) -> tuple[Cell, ...]:
    values = found["figures"]
    commit = found.get("commit", EARLIER)
    return (f"`{name}`", commit, values["training segments"], *(values[key] for key in figures))


def main() -> None:
    options = storing(__doc__)
    store = options.parse_args().store
    networks().tell(store)
    forests().tell(store)


if __name__ == "__main__":
    main()
