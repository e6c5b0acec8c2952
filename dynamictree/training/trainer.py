"""A training that can be stopped and gone on with: optimiser, moving average, checkpoint. Chance hangs on the step."""

import copy
import json
import logging
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.distributed
from jaxtyping import Float32
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from dynamictree.errors import CheckpointError

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Pace:
    """How long, how fast, how averaged."""

    num_steps: int
    learning_rate: float = 1e-3
    warmup_steps: int = 50
    final_share: float = 0.02  # of the learning rate, at the end of a cosine
    halve_every: int | None = None  # steps; in place of the cosine
    cooldown_steps: int | None = None  # in place of the cosine: constant until these last ones, then falling evenly
    weight_decay: float = 1e-4
    gradient_clip: float = 1.0
    ema_decay: float = 0.99
    accumulate: int = 1  # backward passes a step
    bf16: bool = False
    save_every: int = 50
    seed: int = 0

    def rate_at(self, step: int) -> float:
        """Learning rate of a step: a linear start, then a cosine, or halved again and again, or a late fall."""
        warmup = min(1.0, (step + 1) / self.warmup_steps)
        if self.halve_every is not None:
            return self.learning_rate * warmup * 0.5 ** (step // self.halve_every)
        if self.cooldown_steps is not None:
            left = min(1.0, max(0.0, (self.num_steps - step) / self.cooldown_steps))
            return self.learning_rate * (self.final_share + (1 - self.final_share) * left) * warmup
        cosine = (1 + math.cos(math.pi * min(step / self.num_steps, 1))) / 2
        share = self.final_share + (1 - self.final_share) * cosine
        return self.learning_rate * share * warmup


class Course:
    """A network under way. With `torch.distributed` started, processes take their own batches and share gradients."""

    def __init__(self, network: nn.Module, pace: Pace) -> None:
        self.network, self.pace, self.step = network, pace, 0
        self.average = copy.deepcopy(network).requires_grad_(False)
        self.optimizer = torch.optim.AdamW(network.parameters(), lr=pace.learning_rate, weight_decay=pace.weight_decay)

    def run(
        self, loss_of: Callable[[np.random.Generator], Float32[Tensor, ""]], checkpoint: Path | None = None
    ) -> Iterator[tuple[int, float]]:
        """Give each step's number and loss. `loss_of` draws its batch from the generator that it is given."""
        device = next(self.network.parameters()).device.type
        while self.step < self.pace.num_steps:
            total = 0.0
            self.optimizer.zero_grad()
            for micro in range(self.pace.accumulate):
                rng = np.random.default_rng([self.pace.seed, self.step, micro, process_rank()])
                with torch.autocast(device, torch.bfloat16, enabled=self.pace.bf16):
                    loss = loss_of(rng) / self.pace.accumulate
                loss.backward()  # type: ignore[no-untyped-call]
                total += loss.item()
            self._advance()
            due = self.step % self.pace.save_every == 0 or self.step == self.pace.num_steps
            if checkpoint is not None and due and process_rank() == 0:
                self.save(checkpoint)
            yield self.step, total

    def save(self, path: Path) -> None:
        """Write weights, average and moments, in one piece or not at all."""
        tensors = {}
        for name, parameter in self.network.named_parameters():
            state = self.optimizer.state[parameter]
            tensors[f"first.{name}"], tensors[f"second.{name}"] = state["exp_avg"], state["exp_avg_sq"]
        for prefix, module in (("weights", self.network), ("average", self.average)):
            tensors |= {f"{prefix}.{name}": value.detach() for name, value in module.state_dict().items()}
        partial = path.with_suffix(".partial")
        save_file(
            {name: value.contiguous() for name, value in tensors.items()}, partial, {"step": json.dumps(self.step)}
        )
        os.replace(partial, path)
        logger.info("checkpoint written", extra={"step": self.step, "path": str(path)})

    def resume(self, path: Path) -> None:
        """Go on from a checkpoint, if it is there.

        Raises:
            CheckpointError: its tensors are not this network's.
        """
        if not path.exists():
            return
        with safe_open(path, "pt") as stored:
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
            self.step = int(json.loads(stored.metadata()["step"]))
        for prefix, module in (("weights", self.network), ("average", self.average)):
            load_part(module, tensors, prefix)
        for name, parameter in self.network.named_parameters():
            self.optimizer.state[parameter] = {
                "step": torch.tensor(float(self.step)),
                "exp_avg": tensors[f"first.{name}"],
                "exp_avg_sq": tensors[f"second.{name}"],
            }

    def _advance(self) -> None:
        parameters = [parameter for parameter in self.network.parameters() if parameter.grad is not None]
        if torch.distributed.is_initialized():
            flat = torch.cat([parameter.grad.flatten() for parameter in parameters if parameter.grad is not None])
            torch.distributed.all_reduce(flat)
            flat /= torch.distributed.get_world_size()
            for parameter, piece in zip(parameters, torch.split(flat, [p.numel() for p in parameters]), strict=True):
                parameter.grad = piece.view_as(parameter)
        nn.utils.clip_grad_norm_(parameters, self.pace.gradient_clip)
        for group in self.optimizer.param_groups:
            group["lr"] = self.pace.rate_at(self.step)
        self.optimizer.step()
        decay = min(self.pace.ema_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for average, current in zip(self.average.parameters(), self.network.parameters(), strict=True):
                average.lerp_(current, 1 - decay)
        self.step += 1


def load_part(module: nn.Module, tensors: dict[str, Tensor], prefix: str) -> None:
    """Fill a module from the tensors named `prefix`.something.

    Raises:
        CheckpointError: a tensor is missing, unknown, or of another shape.
    """
    own = module.state_dict()
    found = {name.removeprefix(f"{prefix}."): value for name, value in tensors.items() if name.startswith(f"{prefix}.")}
    if own.keys() != found.keys():
        odd = sorted(own.keys() ^ found.keys())
        raise CheckpointError(f"the checkpoint and the network differ in {len(odd)} tensors, the first is {odd[0]}")
    for name, value in found.items():
        if value.shape != own[name].shape:
            shapes = f"{tuple(value.shape)}; the network has {tuple(own[name].shape)}"
            raise CheckpointError(f"{name} is {shapes}; train and load with the same preset")
    module.load_state_dict(found)


def process_rank() -> int:
    """Which of the processes this is."""
    return torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
