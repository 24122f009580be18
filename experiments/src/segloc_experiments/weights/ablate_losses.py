"""The losses against each other: the same network, data, seed and steps for each.

    python -m segloc_experiments.weights.ablate_losses DATASET --steps 1500

Prints a table of ROC area and recall on the validation worlds.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import get_args

from segloc.training.config import Loss, TrainConfig
from segloc.training.shards import load_dataset
from segloc.training.train import train

from ..script import parser


def main() -> None:
    options = parser(__doc__)
    options.add_argument("dataset", type=Path)
    options.add_argument("--network", default="dsm")
    options.add_argument("--steps", type=int, default=1500)
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--different", type=float, default=20.0, help="metres")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    dataset = load_dataset(given.dataset)
    print(f"{given.network}, {given.steps} steps, seed {given.seed}, {len(dataset):,} segments\n")
    print("| loss | AUC | recall@25 | recall@1 |\n|---|---|---|---|")
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
            found = train(dataset, out, config, progress=lambda _: None)
            row = (found.auc, found.recall, found.recall_first)
            print(f"| {loss} | " + " | ".join(f"{value:.4f}" for value in row) + " |", flush=True)


if __name__ == "__main__":
    main()
