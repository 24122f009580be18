"""One process or several that train together, as torchrun starts them."""

from __future__ import annotations

import os

import torch
import torch.distributed as dist
from torch import Tensor, nn

from segloc.errors import ConfigError


class Group:
    """The processes of a run; entered, they are connected where there are several.

    Parameters
    ----------
    device : {"cpu", "cuda"}

    Attributes
    ----------
    rank : int
    leads : bool
        Whether this process is the one that validates aloud and writes files.
    device : torch.device

    Raises
    ------
    ConfigError
        If there is no CUDA device where one is asked for.
    """

    def __init__(self, device: str) -> None:
        if device == "cuda" and not torch.cuda.is_available():
            raise ConfigError("there is no CUDA device; use --device cpu")
        self.rank = int(os.environ.get("RANK", 0))
        self._size = int(os.environ.get("WORLD_SIZE", 1))
        local = int(os.environ.get("LOCAL_RANK", 0))
        self.device = torch.device("cuda", local) if device == "cuda" else torch.device("cpu")
        self.leads = self.rank == 0

    def __enter__(self) -> Group:
        if self._size > 1:
            dist.init_process_group("nccl" if self.device.type == "cuda" else "gloo")
        return self

    def __exit__(self, *_: object) -> None:
        if self._size > 1:
            dist.destroy_process_group()

    def average_gradients(self, model: nn.Module) -> None:
        """Give all processes the mean of their gradients, in one exchange.

        The networks are small, and a task may call any part of one, which a wrapper about
        its ``forward`` would not see.
        """
        if self._size > 1:
            parameters = list(model.parameters())
            self._average([torch.zeros_like(p) if p.grad is None else p.grad for p in parameters])

    def average_buffers(self, model: nn.Module) -> None:
        """Give all processes the mean of their running statistics."""
        if self._size > 1:
            self._average([b for b in model.buffers() if b.is_floating_point()])

    def _average(self, tensors: list[Tensor]) -> None:
        flat = torch.cat([tensor.flatten() for tensor in tensors])
        dist.all_reduce(flat)
        parts = (flat / self._size).split([tensor.numel() for tensor in tensors])
        for tensor, mean in zip(tensors, parts, strict=True):
            tensor.copy_(mean.view_as(tensor))

    def agreed(self, wanted: bool) -> bool:
        """What the leading process wants, so that all stop at the same step."""
        if self._size == 1:
            return wanted
        flag = torch.tensor([float(wanted)], device=self.device)
        dist.broadcast(flag, src=0)
        return bool(flag.item())
