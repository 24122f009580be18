"""FC4 in every way of training, on every domain, over several seeds: is it better than distance?

    python -m segloc_lab.studies.feature_quality.train DATA OUT --device cuda --minutes 8

DATA is a file of ``feature_quality.compact``. For each network and domain OUT gets a JSON file of
areas under the ROC, by FC4 and by plain distance, on the test splits of all domains, and a file of
the tensors of the first seed's networks. What is there already is not trained again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from ...script import parser
from .areas import Areas, areas, difference
from .batches import Objects
from .compact import Segments, read
from .fitting import Effort, choices, draw_pairs, fitted, logits
from .prepare import distances, prepared
from .stack import VARIANTS, Stack

STEPS = {"dsm": 3000, "esm": 1500}
_RATE = 2e-3
_CANDIDATES = 25
_TRAINING_SHARE = 0.65


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--device", default="cpu")
    options.add_argument("--minutes", type=float, default=8.0)
    options.add_argument("--networks", nargs="+", default=list(STEPS))
    options.add_argument("--domains", nargs="+", default=["kitti", "burgess", "robotcar"])
    options.add_argument("--seeds", type=int, default=5)
    options.add_argument("--steps", type=int)
    options.add_argument("--fit-steps", type=int, default=Effort.steps)
    options.add_argument("--fit-pairs", type=int, default=Effort.pairs)
    given = options.parse_args()
    end = time.monotonic() + 60 * given.minutes
    splits = read(given.data)
    given.out.mkdir(parents=True, exist_ok=True)
    tasks = [(n, d) for n in given.networks for d in given.domains]
    missing = [each for each in tasks if not _result(given.out, *each).exists()]
    for number, (network, domain) in enumerate(missing):
        seconds = (end - time.monotonic()) / (len(missing) - number)
        if seconds < 5:
            print("no time is left", flush=True)
            break
        steps = given.steps or STEPS[network]
        job = Job(
            network, domain, given.seeds, steps, seconds, Effort(given.fit_pairs, given.fit_steps)
        )
        run(job, splits, given.out, torch.device(given.device))


def _result(out: Path, network: str, domain: str) -> Path:
    return out / f"{network}-{domain}.json"


@dataclass(frozen=True)
class Job:
    """One network on one domain, in every way for every seed.

    Attributes
    ----------
    network, domain : str
    seeds, steps : int
    seconds : float
        In which training and judging are to end.
    effort : Effort
        Of the heads that are fitted afterwards.
    """

    network: str
    domain: str
    seeds: int
    steps: int
    seconds: float
    effort: Effort


def run(job: Job, splits: dict[str, Segments], out: Path, device: torch.device) -> None:
    """Train and judge all variants of a network on one domain, and write what is found."""
    network, domain = job.network, job.domain
    start = time.monotonic()

    def say(text: str) -> None:
        print(f"{network} {domain} {time.monotonic() - start:.0f} s: {text}", flush=True)

    own = splits[f"{domain}-train"]
    objects = Objects(own, device)
    stack = Stack(network, objects, range(job.seeds), device)
    say(f"{len(objects)} objects, {len(stack.names)} networks")
    done = stack.train(job.steps, _TRAINING_SHARE * job.seconds, _RATE, say)
    heads = _fit(stack, own, job.effort, say)
    tests = {
        name.removesuffix("-test"): _judge(stack, heads, split)
        for name, split in splits.items()
        if name.endswith("-test")
    }
    found = {
        "network": network, "domain": domain, "seeds": job.seeds, "steps": done,
        "seconds": round(time.monotonic() - start, 1), "device": str(device),
        "torch": torch.__version__, "objects": len(objects), "segments": len(objects.kept),
        "variants": [asdict(variant) for variant in VARIANTS], "tests": tests,
    }  # fmt: skip
    tensors = {
        f"{variant}/{name}": tensor.half().contiguous()
        for number, (variant, seed) in enumerate(stack.names)
        if seed == 0
        for name, tensor in stack.state(number).items()
    }
    tensors |= {
        f"{k}/{n}": t[0].cpu().contiguous() for k, (_, p) in heads.items() for n, t in p.items()
    }
    save_file(tensors, out / f"{network}-{domain}.safetensors")
    _result(out, network, domain).write_text(json.dumps(found, indent=1))
    say("done")


Heads = dict[str, tuple[Any, dict[str, Tensor]]]


def _fit(stack: Stack, own: Segments, effort: Effort, say: Callable[[str], None]) -> Heads:
    """FC4 for the networks that were trained alone, by name; on what they saw, and on the rest."""
    points, sizes = (torch.from_numpy(each).to(stack.device) for each in own.padded())
    vectors = stack.describe(prepared(points, sizes))[: len(stack.seeds)]
    heads: Heads = {}
    for where, rows in (("seen", ~own.held), ("held", own.held)):
        among = vectors[:, torch.from_numpy(rows).to(stack.device)]
        pairs = draw_pairs(own.only(rows), among, effort.pairs)
        for name, kind, nearest in choices():
            heads[f"{name}-{where}"] = kind, fitted(among, pairs, nearest, kind, effort.steps)
    say(f"{len(heads)} heads fitted")
    return heads


def _judge(stack: Stack, heads: Heads, split: Segments) -> dict[str, Any]:
    """Areas on the pairs of a test split, and among the candidates that a map would propose."""
    points, sizes = (torch.from_numpy(each).to(stack.device) for each in split.padded())
    vectors = stack.describe(prepared(points, sizes))
    pairs = tuple(
        torch.from_numpy(x).to(stack.device) for x in (split.first, split.second, split.same)
    )
    places = torch.from_numpy(split.squares()).to(stack.device)
    found: dict[str, Any] = {"pairs": len(split.first), "segments": len(split)}
    found["any"] = _compare(stack, heads, vectors, pairs, places)
    found["nearest"] = _nearest(stack, heads, vectors, split)
    return found


def _compare(
    stack: Stack, heads: Heads, vectors: Tensor, pairs: tuple[Tensor, ...], places: Tensor
) -> dict[str, Any]:
    first, second, same = pairs
    a, b = vectors[:, first], vectors[:, second]
    distance = -(a - b).norm(dim=-1)
    result: dict[str, Any] = {}
    S = len(stack.seeds)
    plain = {
        variant.name: areas(distance[k * S : (k + 1) * S], same, places[first])
        for k, variant in enumerate(VARIANTS)
    }
    for k, variant in enumerate(VARIANTS):
        result[f"distance {variant.name}"] = _row(plain[variant.name], plain["alone"])
        if variant.head is not None:
            some = slice(k * S, (k + 1) * S)
            scores = stack.pair_logits(variant.head, a, b)[some]
            judged = areas(scores, same, places[first])
            result[variant.name] = _row(judged, plain[variant.name]) | {
                "against alone": difference(judged, plain["alone"])
            }
    for name, (kind, params) in heads.items():
        judged = areas(logits(kind, params, a[:S], b[:S]), same, places[first])
        result[name] = _row(judged, plain["alone"])
    return result


def _row(judged: Areas, plain: Areas) -> dict[str, Any]:
    return {
        "area": float(judged.value.mean()),
        "by seed": [round(float(value), 5) for value in judged.value],
        "difference": difference(judged, plain),
    }


def _nearest(stack: Stack, heads: Heads, vectors: Tensor, split: Segments) -> dict[str, Any]:
    """How candidates are ordered: of every segment the 25 nearest of other sessions.

    A candidate is right if its centroid lies within 0.5 m. Given are the area under the ROC, and
    the share of right ones among the first 1 and 10 %, each the mean over the seeds.
    """
    S = len(stack.seeds)
    rows: dict[str, list[dict[str, float]]] = {}
    for number, (variant, _) in enumerate(stack.names):
        query, mapped, distance, right = _candidates(vectors[number], split)
        judges = {f"distance {variant}": -distance}
        a, b = vectors[:, query], vectors[:, mapped]
        head = VARIANTS[number // S].head
        if head is not None:
            judges[variant] = stack.pair_logits(head, a, b)[number]
        else:
            for name, (kind, params) in heads.items():
                judges[name] = logits(kind, params, a[:S], b[:S])[number]
        for name, score in judges.items():
            rows.setdefault(name, []).append(_ordered(score, right))
    return {
        name: {key: float(np.mean([each[key] for each in found])) for key in found[0]}
        for name, found in rows.items()
    }


def _candidates(own: Tensor, split: Segments) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Segments, their neighbours of other sessions, how far these are, and which are right."""
    sessions = torch.from_numpy(split.sessions).to(own.device)
    centroids = torch.from_numpy(split.centroids).to(own.device)
    worlds = torch.from_numpy(split.places).to(own.device)
    apart = distances(own, own).masked_fill(sessions[:, None] == sessions[None], torch.inf)
    near = apart.topk(_CANDIDATES, largest=False)
    query = torch.arange(len(own), device=own.device)[:, None].expand_as(near.indices).flatten()
    mapped = near.indices.flatten()
    right = (centroids[query] - centroids[mapped]).norm(dim=1) < 0.5
    return query, mapped, near.values.flatten(), right & (worlds[query] == worlds[mapped])


def _ordered(score: Tensor, right: Tensor) -> dict[str, float]:
    order = score.argsort(descending=True)
    sorted_right = right[order].double()
    count = len(order)
    positive = right.sum()
    ranks = torch.arange(count, 0, -1, device=score.device, dtype=torch.float64)
    area = ((ranks * sorted_right).sum() - positive * (positive + 1) / 2) / (
        positive * (count - positive)
    ).clamp(min=1)
    tops = {f"top {top:g}": float(sorted_right[: int(top * count)].mean()) for top in (0.01, 0.1)}
    return {"area": float(area), "right": float(right.double().mean()), **tops}


if __name__ == "__main__":
    main()
