"""FC4 fitted to the descriptors of given weights, on each domain, over several seeds.

    python -m segloc_lab.weights.pair_head_study WEIGHTS DOMAIN=TRAIN:TEST ... --store DIR

WEIGHTS is a file, or the name of a descriptor that is shipped. A domain's folders are datasets; one
without TRAIN (``kitti00=:TEST``) is a test only. Each seed draws its own pairs and begins with its
own head. Given are the areas under the ROC of the pairs of every test set by plain distance, and by
how much they are larger by FC4: the mean, with its 95 % interval by a bootstrap over places and
seeds, paired. "all" stands for all training sets, each as heavy; a head "as it came" is the one in
the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from segloc.descriptors.pointset import DIM, load_weights
from segloc.descriptors.weightfile import shipped_weights
from segloc.types import Float32

from ..results.fingerprints import DESCRIBING
from ..results.store import Cell, Result
from ..script import storing
from ..studies.feature_quality.areas import areas, difference, gain
from ..studies.paper.pairs import Pairs, labelled_pairs
from ..training.config import HeadKind
from ..training.dataset import SegmentDataset
from ..training.pair_fitting import fit_pair_head
from ..training.pair_heads import PairHead
from ..training.scoring import describe, load_descriptor
from ..training.shards import load_dataset

COLUMNS = ("FC4", "fitted to", "tested on", "distance", "FC4 less distance (95 %)", "by seed")
_PAIRS = 10_000

Described = tuple[Float32, SegmentDataset]


@dataclass(frozen=True)
class Test:
    """Pairs of one domain, and the descriptors (N, dim) of both sides."""

    domain: str
    pairs: Pairs
    first: Float32
    second: Float32

    @classmethod
    def of(cls, domain: str, vectors: Float32, dataset: SegmentDataset) -> Test:
        """As many pairs of one object as of two."""
        pairs = labelled_pairs(dataset, limit=_PAIRS)
        return cls(domain, pairs, vectors[pairs.first], vectors[pairs.second])

    def judged(self, logits: Tensor) -> tuple[Cell, ...]:
        """Area by distance, and how much larger it is by the heads whose logits (M, N) are given.

        The last cell is the least and the largest difference of a head.
        """
        apart = np.linalg.norm(self.first.astype(np.float64) - self.second, axis=1)
        plain = torch.from_numpy(-apart).expand(len(logits), -1)
        same, places = torch.from_numpy(self.pairs.same), torch.from_numpy(self.pairs.places)
        by_distance, by_head = areas(plain, same, places), areas(logits.double(), same, places)
        found = difference(by_head, by_distance)
        each = f"{found['least']:+.4f} to {found['most']:+.4f}" if len(logits) > 1 else None
        return round(float(by_distance.value[0]), 4), gain(found), each


def main() -> None:
    options = storing(__doc__)
    options.add_argument("weights")
    options.add_argument("domains", nargs="+", metavar="DOMAIN=TRAIN:TEST")
    options.add_argument("--heads", nargs="+", choices=get_args(HeadKind), default=["two_layer"])
    options.add_argument("--seeds", type=int, default=5)
    options.add_argument("--limit", type=int, default=5000, help="segments of a dataset")
    given = options.parse_args()
    torch.set_num_threads(1)
    file = Path(given.weights)
    file = file if file.exists() else shipped_weights(f"{given.weights}.safetensors")
    train, tests = _described(file, given.domains, given.limit)
    rows = list(_as_it_came(file, tests))
    sources = {name: [part] for name, part in train.items()} | {"all": list(train.values())}
    for kind, (source, parts) in product(given.heads, sources.items()):
        heads = [_fitted(kind, parts, seed) for seed in range(given.seeds)]
        for test in tests:
            rows.append((kind, source, test.domain, *test.judged(_logits(heads, test))))
    Result.measured(
        f"fc4-{file.stem}",
        f"python -m segloc_lab.weights.pair_head_study {file.stem} DOMAIN=TRAIN:TEST ... "
        f"--heads {' '.join(given.heads)} --seeds {given.seeds} --limit {given.limit} "
        "--store docs/results",
        COLUMNS,
        rows,
        stages=(*DESCRIBING, "training"),
        methods=(file.stem,),
        note=f"{given.seeds} seeds; at most {given.limit} segments of a dataset.",
    ).tell(given.store)


def _described(
    weights: Path, domains: list[str], limit: int
) -> tuple[dict[str, Described], list[Test]]:
    """Training sets by domain, and tests."""
    descriptor = load_descriptor(str(weights), 1)
    train: dict[str, Described] = {}
    tests: list[Test] = []
    for domain in domains:
        name, _, folders = domain.partition("=")
        fitted, _, tested = folders.partition(":")
        for folder in filter(None, (fitted, tested)):
            dataset = load_dataset(Path(folder)).limited(limit, 0)
            vectors = describe(descriptor, dataset)[0]
            if folder == tested:
                tests.append(Test.of(name, vectors, dataset))
            else:
                train[name] = vectors, dataset
    return train, tests


def _as_it_came(weights: Path, tests: list[Test]) -> Iterator[tuple[Cell, ...]]:
    """Rows of the head that the file has, if it has one."""
    head = load_weights(weights).pair_head
    if head is None:
        return
    for test in tests:
        logits = torch.from_numpy(np.asarray(head.logits(test.first, test.second)))
        yield "as it came", None, test.domain, *test.judged(logits[None])


def _fitted(kind: HeadKind, parts: list[Described], seed: int) -> PairHead:
    torch.manual_seed(seed)
    head = PairHead(kind, DIM)
    fit_pair_head(head, parts, seed=seed)
    return head


def _logits(heads: list[PairHead], test: Test) -> Tensor:
    """(M, N) of M heads."""
    first, second = torch.from_numpy(test.first), torch.from_numpy(test.second)
    with torch.no_grad():
        return torch.stack([head(first, second) for head in heads])


if __name__ == "__main__":
    main()
