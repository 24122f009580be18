"""FC4 fitted to the descriptors of given weights, on each domain, over several seeds.

    python -m segloc_experiments.weights.pair_head_study WEIGHTS OUT.json DOMAIN=TRAIN:TEST ...

A domain's folders are datasets; one without TRAIN (``kitti00=:TEST``) is a test only. Each seed
draws its own pairs and begins with its own head. Stored are the areas under the ROC of the pairs of
every test set by FC4 and by plain distance, and the mean difference with its 95 % interval by a
bootstrap over places and seeds, paired. "all" stands for all training sets, each as heavy.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch

from segloc.descriptors.pointset import DIM
from segloc.training.config import HeadKind
from segloc.training.dataset import SegmentDataset
from segloc.training.pair_fitting import fit_pair_head
from segloc.training.pair_heads import PairHead
from segloc.training.scoring import describe, load_descriptor
from segloc.training.shards import load_dataset
from segloc.types import Float32

from ..feature_quality.areas import areas, difference
from ..paper.pairs import Pairs, labelled_pairs
from ..script import parser

Described = tuple[Float32, SegmentDataset]


def main() -> None:
    options = parser(__doc__)
    options.add_argument("weights", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("domains", nargs="+", metavar="DOMAIN=TRAIN:TEST")
    options.add_argument("--heads", nargs="+", choices=get_args(HeadKind), default=["two_layer"])
    options.add_argument("--seeds", type=int, default=5)
    options.add_argument("--limit", type=int, default=5000, help="segments of a dataset")
    given = options.parse_args()
    torch.set_num_threads(1)
    descriptor = load_descriptor(str(given.weights), 1)
    train: dict[str, Described] = {}
    test: dict[str, Described] = {}
    for domain in given.domains:
        name, _, folders = domain.partition("=")
        for sets, folder in zip((train, test), folders.split(":"), strict=True):
            if folder:
                dataset = load_dataset(Path(folder)).limited(given.limit, 0)
                sets[name] = describe(descriptor, dataset)[0], dataset
    pairs = {name: labelled_pairs(dataset, limit=10_000) for name, (_, dataset) in test.items()}
    sources = {name: [part] for name, part in train.items()} | {"all": list(train.values())}
    found: dict[str, Any] = {"weights": given.weights.name, "seeds": given.seeds, "rows": []}
    for kind in given.heads:
        for source, parts in sources.items():
            heads = [_fitted(kind, parts, seed) for seed in range(given.seeds)]
            for name, (vectors, _) in test.items():
                row = _judged(heads, vectors, pairs[name])
                found["rows"].append({"head": kind, "train": source, "test": name, **row})
                print(json.dumps(found["rows"][-1]), flush=True)
    given.out.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def _fitted(kind: HeadKind, parts: list[Described], seed: int) -> PairHead:
    torch.manual_seed(seed)
    head = PairHead(kind, DIM)
    fit_pair_head(head, parts, seed=seed)
    return head


def _judged(heads: list[PairHead], vectors: Float32, pairs: Pairs) -> dict[str, Any]:
    """Areas by distance and by FC4, and their difference."""
    a, b = vectors[pairs.first], vectors[pairs.second]
    with torch.no_grad():
        judged = torch.stack([head(torch.from_numpy(a), torch.from_numpy(b)) for head in heads])
    apart = np.linalg.norm(a.astype(np.float64) - b, axis=1)
    plain = torch.from_numpy(-apart).expand(len(heads), -1)
    same, places = torch.from_numpy(pairs.same), torch.from_numpy(pairs.places)
    by_distance, by_head = areas(plain, same, places), areas(judged.double(), same, places)
    return {
        "pairs": len(pairs),
        "distance": round(float(by_distance.value[0]), 4),
        "FC4": [round(float(value), 4) for value in by_head.value],
        "difference": {k: round(v, 4) for k, v in difference(by_head, by_distance).items()},
    }


if __name__ == "__main__":
    main()
