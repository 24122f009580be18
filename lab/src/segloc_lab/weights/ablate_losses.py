"""The losses against each other: the same network, data, seed and steps for each.

    python -m segloc_lab.weights.ablate_losses DATASET --steps 1500

A table of ROC area and recall on the validation worlds.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import get_args

from ..results.fingerprints import DESCRIBING
from ..results.store import Cell, Result
from ..script import shown, storing
from ..training.config import Loss, TrainConfig
from ..training.shards import load_dataset
from ..training.train import train

COLUMNS = ("loss", "AUC", "recall@25", "recall@1")
COMMAND = "python -m segloc_lab.weights.ablate_losses"


def main() -> None:
    options = storing(__doc__)
    options.add_argument("dataset", type=Path)
    options.add_argument("--network", default="dsm")
    options.add_argument("--steps", type=int, default=1500)
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--different", type=float, default=20.0, help="metres")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    dataset = load_dataset(given.dataset)
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for loss in get_args(Loss):
            config = TrainConfig(
                network=given.network,
                loss=loss,
                steps=given.steps,
                threads=given.threads,
                different_m=given.different,
                seed=given.seed,
            )
            out = Path(folder) / f"{loss}.safetensors"
            found = train(dataset, out, config, progress=print)
            figures = (found.auc, found.recall, found.recall_first)
            rows.append((f"`{loss}`", *(round(value, 3) for value in figures)))
    what = f"--network {given.network} --steps {given.steps} --different {given.different:g}"
    command = f"{COMMAND} {shown(given.dataset)} {what} --seed {given.seed} --store docs/results"
    note, stages = f"{len(dataset):,} segments.", (*DESCRIBING, "training")
    Result.measured("losses", command, COLUMNS, rows, stages=stages, note=note).tell(given.store)


if __name__ == "__main__":
    main()
