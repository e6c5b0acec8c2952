"""Options of a reconstruction, and what a request asks for."""

from dataclasses import dataclass, field

from dynamictree.photo_requests import QUALITIES, LearningParams
from dynamictree.reconstruct.densify import DensityRules
from dynamictree.reconstruct.optimise import Schedule


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """How much of the photos is used, and how long the splat is learned."""

    schedule: Schedule = field(default_factory=Schedule)
    photo_px: int = QUALITIES["standard"].photo_px  # long side to which photos are reduced
    max_views: int = QUALITIES["standard"].max_views  # that depths and splat are made of, evenly chosen


def options_of(params: LearningParams) -> ReconstructOptions:
    """Options of the reconstruction that a request asks for; box and height come after it."""
    limits = QUALITIES[params.quality]
    schedule = Schedule(
        num_steps=params.splat_steps or limits.num_steps,
        side_px=limits.splat_px,
        sh_degree=limits.sh_degree,
        rules=DensityRules(max_gaussians=limits.max_gaussians),
    )
    return ReconstructOptions(schedule=schedule, photo_px=limits.photo_px, max_views=limits.max_views)
