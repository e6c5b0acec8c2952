"""Request parameters of a reconstruction from photos, with range, default, unit and meaning."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator
from pydantic.config import JsonDict

from dynamictree.request_model import Box, Finite, Request, Share

MIN_PHOTOS, MAX_PHOTOS = 8, 300
"""Least and largest number of photos of one reconstruction."""
PHOTOS_OF_VIDEO = 40
"""Default number of frames of a film, one per 9° of a circle: neighbours match, and all pairs take minutes to match."""


Quality = Literal["draft", "standard", "high"]


@dataclass(frozen=True, kw_only=True)
class QualityLimits:
    """Limits by quality: how much of the photos is used, and how large the splat may become."""

    photo_px: int  # long side to which photos are reduced before features are sought
    splat_px: int  # long side of the pictures that the splat is learned from
    max_gaussians: int
    sh_degree: int  # degree of the colours' spherical harmonics
    max_views: int  # photos for depths and splat, evenly chosen; cameras are found for all
    num_steps: int  # training steps where `splat_steps` is unset


QUALITIES: dict[Quality, QualityLimits] = {
    "draft": QualityLimits(
        photo_px=1200, splat_px=320, max_gaussians=30_000, sh_degree=0, max_views=40, num_steps=1000
    ),
    "standard": QualityLimits(
        photo_px=1200, splat_px=640, max_gaussians=80_000, sh_degree=1, max_views=80, num_steps=3000
    ),
    "high": QualityLimits(
        photo_px=1600, splat_px=1600, max_gaussians=300_000, sh_degree=2, max_views=MAX_PHOTOS, num_steps=6000
    ),
}
"""`standard` trains in minutes on two cores (docs/decisions/reconstruct.md); `high` keeps details of 1,600 pixels."""


class Scribble(Request):
    """A stroke or click on a photo that marks the plant or something else."""

    photo: str = Field(min_length=1, max_length=1024, description="The photo's name, as in cameras.json")
    plant: bool = Field(description="True if the stroke marks the plant, false for anything else")
    points: tuple[tuple[Share, Share], ...] = Field(
        min_length=1,
        max_length=1000,
        description="Points along the stroke, from left and from top, as shares of the photo's width and height",
    )


_NUMBER: JsonDict = {"type": "number"}
MarkerEdge = Annotated[Finite, Field(gt=0, lt=10)]
Scribbles = Annotated[tuple[Scribble, ...], Field(min_length=1, max_length=200)]
_SCRIBBLES = (
    "Strokes on photos that mark what is the plant and what is not; the rest is decided from these and from its "
    "look in the photos"
)
_MARKER = (
    "For photos of a printed marker (AprilTag 36h11): edge of its black square [m], which sets the scale; markers of "
    "the sheet in the documentation need no edge"
)
_ONLY_PLANT = "Cut out the plant without strokes: the object in the middle of the photos, without ground and background"


class LearningParams(Request):
    """What decides on the scene that is learned from photos, before the tree is cut out of it."""

    quality: Quality = Field(
        default="standard", description="For photos: sizes of photos and splat; the numbers are in /v1/limits"
    )
    splat_steps: int | None = Field(
        default=None, ge=100, le=30_000, description="For photos: training steps of the splat; by default the quality's"
    )
    video_frames: int | None = Field(
        default=None,
        ge=MIN_PHOTOS,
        le=MAX_PHOTOS,
        description=f"For a film: number of sharp frames used as photos; by default {PHOTOS_OF_VIDEO}",
    )


class PlantParams(Request):
    """What in the photos is the plant, and how large it is. Height and marker both give the scale: one is allowed."""

    model_config = ConfigDict(
        json_schema_extra={
            "not": {"required": ["height_m", "marker_m"], "properties": {"height_m": _NUMBER, "marker_m": _NUMBER}}
        }
    )

    height_m: Finite | None = Field(
        default=None,
        gt=0,
        lt=1000,
        description="For photos, which show no scale: height of the tree [m]; by default 1 m",
    )
    marker_m: MarkerEdge | None = Field(default=None, description=_MARKER)
    scribbles: Scribbles | None = Field(default=None, description=_SCRIBBLES)
    only_plant: bool = Field(default=False, description=_ONLY_PLANT)

    @model_validator(mode="after")
    def _one_scale(self) -> "PlantParams":
        if self.height_m is not None and self.marker_m is not None:
            raise ValueError("height_m and marker_m both give the scale; send one of them")
        return self


class PhotoParams(PlantParams, LearningParams):
    """How to reconstruct a tree from photos."""


class CutParams(PlantParams):
    """How to cut the plant out of a finished reconstruction."""

    box_m: Box | None = Field(
        default=None, description="Box around the plant: low and high corner [m] in the frame of the folder's files"
    )
    height_m: Finite | None = Field(
        default=None, gt=0, lt=1000, description="Height of the plant [m]; by default the scale stays"
    )

    @property
    def cuts(self) -> bool:
        """Whether the plant is cut out at all."""
        return self.box_m is not None or self.scribbles is not None or self.only_plant

    @property
    def scales(self) -> bool:
        """Whether the request sets a scale."""
        return self.height_m is not None or self.marker_m is not None
