"""Options of a reconstruction, and those that a request selects."""

from dataclasses import dataclass, field

from dynamictree.photo_requests import QUALITIES, LearningParams
from dynamictree.reconstruct.densify import DensityRules
from dynamictree.reconstruct.optimise import Schedule


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """Resolution and number of the photos used, and the schedule of the splat's optimisation."""

    schedule: Schedule = field(default_factory=Schedule)
    photo_px: int = QUALITIES["standard"].photo_px  # long side to which photos are reduced
    max_views: int = QUALITIES["standard"].max_views  # number of photos for depths and splat, evenly chosen


def options_of(params: LearningParams) -> ReconstructOptions:
    """Return the options that a request selects; its box and height are applied afterwards."""
    limits = QUALITIES[params.quality]
    schedule = Schedule(
        num_steps=params.splat_steps or limits.num_steps,
        side_px=limits.splat_px,
        sh_degree=limits.sh_degree,
        rules=DensityRules(max_gaussians=limits.max_gaussians),
    )
    return ReconstructOptions(schedule=schedule, photo_px=limits.photo_px, max_views=limits.max_views)
