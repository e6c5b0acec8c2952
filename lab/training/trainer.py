"""AdamW with a learning-rate schedule, a moving average of the weights, and checkpoints.

The random generator is seeded by the step, so an interrupted run resumes identically.
"""

import copy
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor, nn

from lab.training.checkpoints import load_checkpoint, save_checkpoint
from lab.training.distributed import average_gradients, process_rank


@dataclass(frozen=True, kw_only=True)
class LearningRateSchedule:
    """Number of steps and the learning rate of each step. At most one of `halve_every` and `cooldown_steps` is set."""

    num_steps: int
    learning_rate: float = 1e-3
    warmup_steps: int = 50
    final_share: float = 0.02  # share of the learning rate at the end
    halve_every: int | None = None  # [steps]; replaces the cosine
    cooldown_steps: int | None = None  # replaces the cosine: constant, then linear over these last steps

    def rate_at(self, step: int) -> float:
        """Return the learning rate of a step, counted from 0."""
        peak = self.learning_rate * min(1.0, (step + 1) / self.warmup_steps)
        if self.halve_every is not None:
            return peak * 0.5 ** (step // self.halve_every)
        if self.cooldown_steps is not None:
            remaining = min(1.0, max(0.0, (self.num_steps - step) / self.cooldown_steps))
        else:
            remaining = (1 + math.cos(math.pi * min(step / self.num_steps, 1))) / 2
        return peak * (self.final_share + (1 - self.final_share) * remaining)


@dataclass(frozen=True, kw_only=True)
class TrainerOptions:
    """Training options that do not depend on the model."""

    schedule: LearningRateSchedule
    weight_decay: float = 1e-4
    gradient_clip: float = 1.0
    ema_decay: float = 0.99
    accumulate: int = 1  # backward passes per step
    bf16: bool = False
    save_every: int = 50  # [steps]
    save_every_s: float | None = None  # additional interval between checkpoints
    seed: int = 0

    def with_steps(self, num_steps: int) -> "TrainerOptions":
        """Return the same options for another number of steps."""
        return replace(self, schedule=replace(self.schedule, num_steps=num_steps))

    def with_slower_rate(self, share: float) -> "TrainerOptions":
        """Return the same options with a reduced learning rate."""
        rate = share * self.schedule.learning_rate
        return replace(self, schedule=replace(self.schedule, learning_rate=rate))


class Trainer:
    """Trainer of one network. Under `torch.distributed`, processes draw their own batches and average gradients."""

    def __init__(self, network: nn.Module, options: TrainerOptions) -> None:
        self.network, self.options, self.step = network, options, 0
        self.average = copy.deepcopy(network).requires_grad_(False)
        trained = [parameter for parameter in network.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.AdamW(
            trained, lr=options.schedule.learning_rate, weight_decay=options.weight_decay
        )

    @property
    def finished(self) -> bool:
        """Return whether every step is done."""
        return self.step >= self.options.schedule.num_steps

    def run(
        self, loss_of: Callable[[np.random.Generator], Float32[Tensor, ""]], checkpoint: Path | None = None
    ) -> Iterator[tuple[int, float]]:
        """Yield each step's number and loss. `loss_of` draws its batch from the generator that it receives."""
        options, saved_at = self.options, time.monotonic()
        device = next(self.network.parameters()).device.type
        while not self.finished:
            total = 0.0
            self.optimizer.zero_grad()
            for micro in range(options.accumulate):
                rng = np.random.default_rng([options.seed, self.step, micro, process_rank()])
                with torch.autocast(device, torch.bfloat16, enabled=options.bf16):
                    loss = loss_of(rng) / options.accumulate
                loss.backward()  # type: ignore[no-untyped-call]
                total += loss.item()
            self._advance()
            due = self.finished or self.step % options.save_every == 0
            if options.save_every_s is not None and time.monotonic() - saved_at > options.save_every_s:
                due = True
            if checkpoint is not None and due and process_rank() == 0:
                self.save(checkpoint)
                saved_at = time.monotonic()
            yield self.step, total

    def save(self, path: Path) -> None:
        """Write a checkpoint."""
        save_checkpoint(path, step=self.step, network=self.network, average=self.average, optimizer=self.optimizer)

    def resume(self, path: Path) -> None:
        """Continue from a checkpoint, if the file exists.

        Raises:
            CheckpointError: its tensors are not this network's.
        """
        if path.exists():
            self.step = load_checkpoint(path, network=self.network, average=self.average, optimizer=self.optimizer)

    def _advance(self) -> None:
        parameters = [parameter for parameter in self.network.parameters() if parameter.grad is not None]
        average_gradients(parameters)
        nn.utils.clip_grad_norm_(parameters, self.options.gradient_clip)
        for group in self.optimizer.param_groups:
            group["lr"] = self.options.schedule.rate_at(self.step)
        self.optimizer.step()
        decay = min(self.options.ema_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for average, current in zip(self.average.parameters(), self.network.parameters(), strict=True):
                average.lerp_(current, 1 - decay)
        self.step += 1
