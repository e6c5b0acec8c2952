"""Learning rate by step: warm-up, then a cosine, repeated halving, or a constant with a linear end."""

import math
from dataclasses import dataclass


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
