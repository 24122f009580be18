"""FC4 for weights that are there: fitted to their descriptors, which stay as they are.

    python -m segloc_lab.weights.add_pair_head WEIGHTS OUT DATASET [DATASET ...]

Maps that were made with the weights stay valid. The datasets should hold places that the weights
were not trained on.
"""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import torch

from segloc.descriptors.pointset import DIM, KIND
from segloc.descriptors.weightfile import read_weights, write_weights

from ..script import parser
from ..training.config import HeadKind
from ..training.pair_fitting import fit_pair_head
from ..training.pair_heads import PairHead
from ..training.scoring import describe, load_descriptor
from ..training.shards import load_dataset

_LIMIT = 8000


def main() -> None:
    options = parser(__doc__)
    options.add_argument("weights", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("datasets", type=Path, nargs="+")
    options.add_argument("--head", choices=get_args(HeadKind), default="two_layer")
    options.add_argument("--negatives", choices=("any", "mined"), default="any")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    descriptor = load_descriptor(str(given.weights), 1)
    parts = []
    for path in given.datasets:
        dataset = load_dataset(path).limited(_LIMIT, given.seed)
        parts.append((describe(descriptor, dataset)[0], dataset))
    torch.manual_seed(given.seed)
    head = PairHead(given.head, DIM)
    fit_pair_head(head, parts, nearest=given.negatives == "mined", seed=given.seed)
    tensors = {name: np.ascontiguousarray(t.numpy()) for name, t in head.tensors().items()}
    file = read_weights(given.weights, KIND)
    note = {
        "head": given.head,
        "negatives": given.negatives,
        "data": [path.name for path in given.datasets],
        "segments": sum(len(dataset) for _, dataset in parts),
        "seed": given.seed,
    }
    kept = {name: t for name, t in file.tensors.items() if not name.startswith("pair.")}
    write_weights(given.out, KIND, {**kept, **tensors}, file.settings, {**file.card, "fc4": note})
    print(f"{given.out}: FC4 ({given.head}) fitted to {note['segments']} segments")


if __name__ == "__main__":
    main()
