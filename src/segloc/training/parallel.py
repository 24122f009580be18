"""One process or several that train together, as torchrun starts them."""

from __future__ import annotations

import os

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from ..errors import ConfigError


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

    def shared(self, model: nn.Module) -> nn.Module:
        """The model with its gradients averaged over the processes."""
        if self._size == 1:
            return model
        devices = [self.device] if self.device.type == "cuda" else None
        return DistributedDataParallel(model, device_ids=devices, find_unused_parameters=True)

    def agreed(self, wanted: bool) -> bool:
        """What the leading process wants, so that all stop at the same step."""
        if self._size == 1:
            return wanted
        flag = torch.tensor([float(wanted)], device=self.device)
        dist.broadcast(flag, src=0)
        return bool(flag.item())
