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
from service.http.problems import wrong_field
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
    """The models that jobs may name."""

    data: list[PresetPayload]


class ProductPayload(Payload):
    """One format that a motion can be written as."""

    format: Format
    title: str
    file_name: str
    media_type: str
    shows: Literal["mesh", "splat", "pictures"]
    options: list[str] = Field(description="parameters of an animate job that this file depends on")


class PhotoQualityPayload(Payload):
    """What a reconstruction of one `quality` uses of its photos, and how large its splat may become."""

    quality: Quality
    photo_px: int = Field(description="long side to which photos are reduced before features are sought")
    splat_px: int = Field(description="long side of the pictures that the splat is learned from")
    max_gaussians: int
    sh_degree: int = Field(description="of the splat's colours")
    max_views: int = Field(description="photos that depths and splat are made of; cameras are found for all")
    num_steps: int = Field(description="of training, unless splat_steps says otherwise")


class LimitsPayload(Payload):
    """Limits of requests and uploads. Sizes in bytes."""

    mesh_formats: list[str]
    cloud_formats: list[str]
    photo_formats: list[str]
    film_formats: list[str] = Field(description="of a walk around one tree, from which photos are chosen")
    products: list[ProductPayload] = Field(description="what params.formats of an animate job may name")
    max_json_bytes: int
    max_interact_bytes: int
    max_multipart_bytes: int
    min_photos: int
    max_photos: int
    max_photo_bytes: int
    photo_qualities: list[PhotoQualityPayload] = Field(description="what quality of a job on photos may be")
    max_film_bytes: int
    max_film_s: float
    max_film_pixels: int = Field(description="width times height")
    max_files: int = Field(description="of one asset: parts of a form, entries of a zip, or uploads")
    max_archive_ratio: int
    max_vertices: int
    max_faces: int
    max_frames: int = Field(description="of a loop")
    max_turbulent_frames: int = Field(description="of a motion that never repeats")
    max_gaussians: int
    max_sequence_bytes: int = Field(description="of a sequence of splats")
    max_forces: int = Field(description="of one push")
    max_force_groups: int = Field(description="places that swing at once")
    max_displacement_bytes: int = Field(description="of one answer in voxels, vertices or Gaussians")
    max_queued_jobs: int
    artifact_retention_s: float = Field(description="lifetime of artifacts [s]")
    asset_retention_s: float = Field(description="lifetime of uploads after their last use [s]")


MAX_PRESET_NAME = 64
"""Width of the job store's column for a model's name [characters]."""


def preset_sizes() -> dict[str, int]:
    """Return the models that jobs may use, with the size of their weights [bytes]."""
    models = sorted(list_weights().items())
    return {name: path.stat().st_size for name, path in models if len(name) <= MAX_PRESET_NAME}


def require_preset(name: str) -> None:
    """Refuse a model that does not exist."""
    if name not in preset_sizes():
        detail = f"there is no preset {name!r}; there are {', '.join(preset_sizes()) or 'none'}"
        raise wrong_field("/preset", "unknown-preset", detail)


@router.get("/presets", responses=refusals())
def list_presets() -> PresetListPayload:
    """The models that diffuse and animate jobs may name."""
    return PresetListPayload(data=[PresetPayload(name=name, bytes=size) for name, size in preset_sizes().items()])


@router.get("/limits", responses=refusals())
def get_limits(owned: OwnedDep) -> LimitsPayload:
    """Sizes, numbers and formats that are allowed."""
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
    """What attempts of jobs took that ended in one month (UTC)."""

    month: str = Field(description="2026-11")
    attempts: int
    processor_s: float
    gpu_s: float = Field(description="during which a worker with a GPU was at work [s]")


class UsagePayload(Payload):
    """What the caller has, and may have; null where no key is asked for."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[Limit, int] | None
    months: list[MonthPayload] = Field(description="newest first, at most 12")


@router.get("/usage", responses=refusals())
def get_usage(owned: OwnedDep) -> UsagePayload:
    """Jobs that have not ended, bytes stored, the limits of the key, and what jobs took by month."""
    caller = owned.caller
    return UsagePayload(
        owner=caller.owner,
        active_jobs=count_jobs(owned.store, ACTIVE),
        bytes=stored_bytes(owned.store),
        limits=dict(caller.limits) or None,
        months=[MonthPayload.model_validate(month) for month in months(owned.store)],
    )
