"""Training checkpoints as safetensors: weights, their moving average, and AdamW's moments."""

import json
import logging
import os
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from dynamictree.errors import CheckpointError

logger = logging.getLogger(__name__)


def save_checkpoint(
    path: Path, *, step: int, network: nn.Module, average: nn.Module, optimizer: torch.optim.Optimizer
) -> None:
    """Write a checkpoint atomically: a reader never sees an incomplete one."""
    tensors = {}
    for name, parameter in _trained(network):
        state = optimizer.state[parameter]
        tensors[f"first.{name}"], tensors[f"second.{name}"] = state["exp_avg"], state["exp_avg_sq"]
    for prefix, module in (("weights", network), ("average", average)):
        tensors |= {f"{prefix}.{name}": value.detach() for name, value in module.state_dict().items()}
    partial = path.with_suffix(".partial")
    save_file({name: value.contiguous() for name, value in tensors.items()}, partial, {"step": json.dumps(step)})
    os.replace(partial, path)
    logger.info("checkpoint written", extra={"step": step, "path": str(path)})


def load_checkpoint(path: Path, *, network: nn.Module, average: nn.Module, optimizer: torch.optim.Optimizer) -> int:
    """Load a checkpoint in place and return its step; the moments take the device and type of their parameters.

    Raises:
        CheckpointError: its tensors are not this network's.
    """
    with safe_open(path, "pt") as stored:
        tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
        step = int(json.loads(stored.metadata()["step"]))
    for prefix, module in (("weights", network), ("average", average)):
        load_part(module, tensors, prefix)
    moments = {
        index: {
            "step": torch.tensor(float(step)),
            "exp_avg": tensors[f"first.{name}"],
            "exp_avg_sq": tensors[f"second.{name}"],
        }
        for index, (name, _) in enumerate(_trained(network))
    }
    optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})
    return step


def _trained(network: nn.Module) -> list[tuple[str, nn.Parameter]]:
    return [(name, one) for name, one in network.named_parameters() if one.requires_grad]


def load_part(module: nn.Module, tensors: dict[str, Tensor], prefix: str) -> None:
    """Fill a module from the tensors named `prefix`.*.

    Raises:
        CheckpointError: a tensor is missing, unexpected, or of another shape.
    """
    own = module.state_dict()
    part = {name.removeprefix(f"{prefix}."): value for name, value in tensors.items() if name.startswith(f"{prefix}.")}
    if own.keys() != part.keys():
        odd = sorted(own.keys() ^ part.keys())
        raise CheckpointError(f"the checkpoint and the network differ in {len(odd)} tensors, the first is {odd[0]}")
    for name, value in part.items():
        if value.shape != own[name].shape:
            shapes = f"{tuple(value.shape)}; the network has {tuple(own[name].shape)}"
            raise CheckpointError(f"{name} is {shapes}; train and load with the same preset")
    module.load_state_dict(part)
