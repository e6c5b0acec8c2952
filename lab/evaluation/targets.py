"""Targets for a model's figures on unseen species, by vertex after devoxelization."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Methods = Mapping[str, Mapping[str, float]]
"""Figures by method."""

FLOOR = "second wind"
MAX_ROUGHNESS_ERROR = 0.5
RULE = (
    "log-amplitude RMSE below the by-height mean's, and roughness within 50 % of the truth's, "
    "on seen and on unseen species"
)


@dataclass(frozen=True, kw_only=True)
class Target:
    """A bound on one figure."""

    figure: str
    sense: Literal["at least", "at most", "within"]
    bound: float

    def error(self, value: float) -> float:
        """Return the distance of a value from the bound; 0 if it meets the bound."""
        beyond = {"at least": self.bound - value, "at most": value - self.bound, "within": abs(value - 1) - self.bound}
        return max(0.0, beyond[self.sense])


TARGETS = (
    Target(figure="log_amplitude_correlation", sense="at least", bound=0.93),
    Target(figure="log_amplitude_rmse", sense="at most", bound=0.25),
    Target(figure="centroid_correlation", sense="at least", bound=0.8),
    Target(figure="roughness_ratio", sense="within", bound=0.2),
    Target(figure="stretch_p99", sense="at most", bound=0.05),
    Target(figure="root_share", sense="at most", bound=0.005),
    Target(figure="loop_jump", sense="at most", bound=1.0),
)


def targets_of(methods: Methods) -> list[dict[str, object]]:
    """Return, for each target, the model's value, whether it meets the bound, and by how much it misses.

    `floor` is the same figure for the true motion in other gusts: no model can be expected to do better.
    """
    return [
        {
            "figure": target.figure,
            "wanted": f"{target.sense} {target.bound:g}" + (" of 1" if target.sense == "within" else ""),
            "value": methods["model"][target.figure],
            "floor": methods[FLOOR][target.figure],
            "met": target.error(methods["model"][target.figure]) == 0,
            "missed_by": target.error(methods["model"][target.figure]),
        }
        for target in TARGETS
    ]


def passes(methods: Methods) -> bool:
    """Return whether the weights may ship, by RULE."""
    model, baseline = methods["model"], methods["by-height mean"]
    better = model["log_amplitude_rmse"] < baseline["log_amplitude_rmse"]
    return better and abs(model["roughness_ratio"] - 1) <= MAX_ROUGHNESS_ERROR
