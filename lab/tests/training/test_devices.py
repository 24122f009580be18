"""What does not depend on the device, on a CPU: precision under autocast, several processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

torch = pytest.importorskip("torch")

from segloc_lab.training.pair_fitting import pair_loss  # noqa: E402
from segloc_lab.training.tasks import LOSSES  # noqa: E402

TOGETHER = """
import json
import torch
from segloc_lab.training.train import Group
with Group("cpu") as group:
    torch.manual_seed(0)
    model = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.BatchNorm1d(2))
    x = torch.full((4, 3), float(group.rank)) + torch.arange(4.0)[:, None]
    model(x).square().sum().backward()
    model[1].running_mean += group.rank
    own = [model[0].weight.grad.clone(), model[1].running_mean.clone()]
    group.average_gradients(model)
    group.average_buffers(model)
    mean = [model[0].weight.grad, model[1].running_mean]
    wanted = group.agreed(group.rank == 0)
print(json.dumps([[t.flatten().tolist() for t in ts] for ts in (own, mean)] + [wanted]))
"""


def test_losses_stay_in_single_precision_under_autocast() -> None:
    torch.manual_seed(0)
    labels = torch.arange(32) // 2
    same = (labels[:, None] == labels[None, :]) & ~torch.eye(32, dtype=torch.bool)
    different = labels[:, None] != labels[None, :]
    x, logits = 3 + torch.randn(32, 16), torch.randn(32, 32)
    for loss, values in [*((loss, x) for loss in LOSSES.values()), (pair_loss, logits)]:
        expected = loss(values, same, different)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            assert (x @ x.T).dtype == torch.bfloat16  # or there is nothing to be shown
            found = loss(values, same, different)
        assert found.dtype == torch.float32 and torch.equal(found, expected)


@pytest.mark.slow
def test_processes_go_on_with_the_mean_of_their_gradients() -> None:
    store = torch.distributed.TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)
    common = {
        **os.environ,
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(store.port),
        "TORCHELASTIC_USE_AGENT_STORE": "True",  # it is there: none of the two opens a port
    }
    running = [
        subprocess.Popen(
            [sys.executable, "-c", TOGETHER],
            env={**common, "RANK": str(rank)},
            stdout=subprocess.PIPE,
            text=True,
        )
        for rank in (0, 1)
    ]
    outputs = [process.communicate(timeout=240)[0] for process in running]
    (one, mean, wanted), (two, same_mean, too) = (json.loads(text) for text in outputs)
    assert mean == same_mean and wanted is too is True
    assert one != two
    for a, b, both in zip(one, two, mean, strict=True):
        assert both == pytest.approx([(x + y) / 2 for x, y in zip(a, b, strict=True)], rel=1e-6)
