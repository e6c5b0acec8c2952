"""/v1/presets, /v1/limits and /v1/usage: models, formats and limits, and what the caller has of them."""

from typing import Literal

from fastapi import APIRouter
from pydantic import Field

from dynamictree.formats import film, suffixes
from dynamictree.photo_requests import MAX_PHOTOS, MIN_PHOTOS, QUALITIES, Quality
from dynamictree.requests import MAX_FRAMES, MAX_TURBULENT_FRAMES, Format
from dynamictree.weights import list_weights
from jobs.clients.usage import count_jobs, months, stored_bytes
from jobs.records import Limit
from jobs.states import ACTIVE
from service.http import multipart
from service.http.routing import refusals
from service.interact import forces
from service.routes import interact
from service.schemas.base import Payload
from service.services import OwnedDep
from service.uploads import archives, intake

router = APIRouter(prefix="/v1", tags=["catalogue"])


class PresetPayload(Payload):
    """A trained model."""

    name: str
    bytes: int


class PresetListPayload(Payload):
    """The models that jobs can use."""

    data: list[PresetPayload]


class ProductPayload(Payload):
    """One file format of a motion."""

    format: Format
    title: str
    file_name: str
    media_type: str
    shows: Literal["mesh", "splat", "pictures"]
    options: list[str] = Field(description="Parameters of an animate job that affect this file")


class PhotoQualityPayload(Payload):
    """Limits of a reconstruction of one `quality`: sizes of photos and splat."""

    quality: Quality
    photo_px: int = Field(description="Long side of photos for feature detection [px]")
    splat_px: int = Field(description="Long side of photos for training the splat [px]")
    max_gaussians: int
    sh_degree: int = Field(description="Degree of the splat's spherical harmonics")
    max_views: int = Field(description="Largest number of photos for depth maps and splat")
    num_steps: int = Field(description="Training steps if splat_steps is unset")


class LimitsPayload(Payload):
    """Limits of requests and uploads. Sizes in bytes."""

    mesh_formats: list[str]
    cloud_formats: list[str]
    photo_formats: list[str]
    film_formats: list[str] = Field(description="Formats of films, from which photos are chosen")
    products: list[ProductPayload] = Field(description="Values of params.formats of an animate job")
    max_json_bytes: int
    max_interact_bytes: int
    max_multipart_bytes: int
    min_photos: int
    max_photos: int
    max_photo_bytes: int
    photo_qualities: list[PhotoQualityPayload] = Field(description="Values of quality of a job with photos")
    max_film_bytes: int
    max_film_s: float
    max_film_pixels: int = Field(description="Largest width times height [px]")
    max_files: int = Field(description="Files per asset: form parts, zip entries or uploads")
    max_archive_ratio: int
    max_vertices: int
    max_faces: int
    max_frames: int = Field(description="Frames of a loop")
    max_turbulent_frames: int = Field(description="Frames of a turbulent motion")
    max_gaussians: int
    max_sequence_bytes: int = Field(description="Size of a sequence of splats [bytes]")
    max_forces: int = Field(description="Forces per request")
    max_force_groups: int = Field(description="Groups of forces (places) per request")
    max_displacement_bytes: int = Field(description="Size of a binary response of /v1/interact [bytes]")
    max_queued_jobs: int
    artifact_retention_s: float = Field(description="Lifetime of artifacts [s]")
    asset_retention_s: float = Field(description="Lifetime of assets after their last use [s]")


MAX_PRESET_NAME = 64
"""Width of the job store's column for a model's name [characters]."""


def preset_sizes() -> dict[str, int]:
    """Return the models that jobs may use, with the size of their weights [bytes]."""
    models = sorted(list_weights().items())
    return {name: path.stat().st_size for name, path in models if len(name) <= MAX_PRESET_NAME}


@router.get("/presets", responses=refusals())
def list_presets() -> PresetListPayload:
    """List the models that diffuse and animate jobs can use."""
    return PresetListPayload(data=[PresetPayload(name=name, bytes=size) for name, size in preset_sizes().items()])


@router.get("/limits", responses=refusals())
def get_limits(owned: OwnedDep) -> LimitsPayload:
    """Return limits of sizes and numbers, and supported formats."""
    from dynamictree.export.table import available_products
    from dynamictree.gaussian.cloud import MAX_GAUSSIANS, MAX_SEQUENCE_BYTES
    from dynamictree.mesh import MAX_FACES, MAX_VERTICES

    return LimitsPayload.of(
        owned.services.settings,
        mesh_formats=[suffix.lstrip(".") for suffix in suffixes.MESH_SUFFIXES],
        cloud_formats=[suffix.lstrip(".") for suffix in suffixes.CLOUD_SUFFIXES],
        photo_formats=[suffix.lstrip(".") for suffix in suffixes.PHOTO_SUFFIXES],
        film_formats=[suffix.lstrip(".") for suffix in suffixes.FILM_SUFFIXES],
        products=[
            ProductPayload.of(product, format=name, options=sorted(product.options))
            for name, product in available_products().items()
        ],
        photo_qualities=[PhotoQualityPayload.of(limits, quality=name) for name, limits in QUALITIES.items()],
        **{"min_photos": MIN_PHOTOS, "max_photos": MAX_PHOTOS, "max_photo_bytes": intake.MAX_PHOTO_BYTES},
        **{"max_film_bytes": film.MAX_FILM_BYTES, "max_film_s": film.MAX_FILM_S},
        **{"max_film_pixels": film.MAX_FILM_PIXELS, "max_frames": MAX_FRAMES, "max_vertices": MAX_VERTICES},
        **{"max_files": multipart.MAX_FILES, "max_archive_ratio": archives.MAX_RATIO, "max_faces": MAX_FACES},
        **{"max_turbulent_frames": MAX_TURBULENT_FRAMES, "max_displacement_bytes": interact.MAX_DISPLACEMENT_BYTES},
        **{"max_gaussians": MAX_GAUSSIANS, "max_sequence_bytes": MAX_SEQUENCE_BYTES},
        **{"max_forces": forces.MAX_FORCES, "max_force_groups": forces.MAX_GROUPS},
    )


class MonthPayload(Payload):
    """Resource use of attempts of jobs that ended in one month (UTC)."""

    month: str = Field(description="Month (UTC) as YYYY-MM")
    attempts: int
    processor_s: float
    gpu_s: float = Field(description="Run time on workers with a GPU [s]")


class UsagePayload(Payload):
    """Resource use and limits of the caller; null if no key is required."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[Limit, int] | None
    months: list[MonthPayload] = Field(description="Up to 12 months, newest first")


@router.get("/usage", responses=refusals())
def get_usage(owned: OwnedDep) -> UsagePayload:
    """Return active jobs, stored bytes, the limits of the key, and resource use by month."""
    caller = owned.caller
    return UsagePayload(
        owner=caller.owner,
        active_jobs=count_jobs(owned.store, ACTIVE),
        bytes=stored_bytes(owned.store),
        limits=dict(caller.limits) or None,
        months=[MonthPayload.model_validate(month) for month in months(owned.store)],
    )
