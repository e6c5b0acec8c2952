"""One function per operation: its request, and the type of its response. Made by client/generate.py; do not edit."""

from datetime import datetime
from typing import Any, Literal

from dynamictree_client.call import Call, path_of
from dynamictree_client.models import (
    AnimateRequest,
    Asset,
    DeliveryList,
    DiffuseRequest,
    EndpointList,
    EndpointRequest,
    EndpointWithSecret,
    Interact,
    InteractRequest,
    Job,
    JobList,
    JobState,
    Limits,
    Link,
    LinkRequest,
    Live,
    Manifest,
    Ops,
    PresetList,
    Ready,
    ReconstructRequest,
    Spectrum,
    TurbulentWind,
    Upload,
    UploadParts,
    Usage,
    VoxelizeRequest,
)


def get_upload_protocol() -> Call[None]:
    """Supported tus versions and extensions."""
    return Call(method="OPTIONS", path="/v1/uploads", answer=None)


def create_upload(
    content: bytes,
    *,
    tus_resumable: str | None = None,
    upload_length: str | None = None,
    upload_metadata: str | None = None,
    content_type: str | None = None,
) -> Call[None]:
    """Begin an upload; its first bytes may come with it."""
    return Call(
        method="POST",
        path="/v1/uploads",
        answer=None,
        headers={
            "Tus-Resumable": tus_resumable,
            "upload-length": upload_length,
            "upload-metadata": upload_metadata,
            "content-type": content_type,
        },
        content=content,
        content_type="application/offset+octet-stream",
    )


def head_upload(id: str, *, tus_resumable: str | None = None) -> Call[None]:
    """Current offset of an upload."""
    return Call(
        method="HEAD",
        path=path_of("/v1/uploads/{id}", {"id": id}),
        answer=None,
        headers={"Tus-Resumable": tus_resumable},
    )


def append_to_upload(
    id: str,
    content: bytes,
    *,
    tus_resumable: str | None = None,
    upload_offset: str | None = None,
    content_type: str | None = None,
) -> Call[None]:
    """Append to an upload. Bytes received before a connection breaks are stored."""
    return Call(
        method="PATCH",
        path=path_of("/v1/uploads/{id}", {"id": id}),
        answer=None,
        headers={"Tus-Resumable": tus_resumable, "upload-offset": upload_offset, "content-type": content_type},
        content=content,
        content_type="application/offset+octet-stream",
    )


def get_upload(id: str, *, prefer: str | None = None) -> Call[Upload]:
    """An upload: how much is there, and the asset once there is one. Prefer: wait=N waits until that is settled."""
    return Call(method="GET", path=path_of("/v1/uploads/{id}", {"id": id}), answer=Upload, headers={"prefer": prefer})


def delete_upload(id: str, *, tus_resumable: str | None = None) -> Call[None]:
    """Give an upload up. An asset that was made of it stays."""
    return Call(
        method="DELETE",
        path=path_of("/v1/uploads/{id}", {"id": id}),
        answer=None,
        headers={"Tus-Resumable": tus_resumable},
    )


def create_upload_parts(id: str) -> Call[UploadParts]:
    """Addresses in object storage to PUT the missing bytes to; then PATCH at the whole length, without bytes.  409
    where the bytes lie in a folder, or the setting `presigned_links` is off.
    """
    return Call(method="POST", path=path_of("/v1/uploads/{id}/parts", {"id": id}), answer=UploadParts)


def create_asset(body: dict[str, Any]) -> Call[Asset | Upload]:
    """Send a mesh, photos or a film, name uploads that hold them, or an address to fetch them from."""
    return Call(method="POST", path="/v1/assets", answer=Asset | Upload, body=body)


def get_asset(id: str) -> Call[Asset]:
    """What was uploaded, and what was found in it."""
    return Call(method="GET", path=path_of("/v1/assets/{id}", {"id": id}), answer=Asset)


def delete_asset(id: str) -> Call[None]:
    """Forget an upload. What was made of it stays until it expires."""
    return Call(method="DELETE", path=path_of("/v1/assets/{id}", {"id": id}), answer=None)


def create_job(
    body: ReconstructRequest | VoxelizeRequest | DiffuseRequest | AnimateRequest, *, idempotency_key: str | None = None
) -> Call[Job]:
    """Create a job for voxels, a spectrum, a motion, or a mesh of photos. Earlier stages run first or are cached."""
    return Call(method="POST", path="/v1/jobs", answer=Job, headers={"idempotency-key": idempotency_key}, body=body)


def list_jobs(
    *,
    state: JobState | None = None,
    type: Literal["reconstruct", "voxelize", "diffuse", "animate"] | None = None,
    asset_id: str | None = None,
    external_id: str | None = None,
    since: datetime | None = None,
    cursor: str | None = None,
    limit: int | None = None,
) -> Call[JobList]:
    """Jobs, newest first."""
    return Call(
        method="GET",
        path="/v1/jobs",
        answer=JobList,
        query={
            "state": state,
            "type": type,
            "asset_id": asset_id,
            "external_id": external_id,
            "since": since,
            "cursor": cursor,
            "limit": limit,
        },
    )


def retry_job(id: str) -> Call[Job]:
    """Run a job that has ended again, as a new job; stages that finished are taken from the cache."""
    return Call(method="POST", path=path_of("/v1/jobs/{id}/retry", {"id": id}), answer=Job)


def get_job(id: str, *, if_none_match: str | None = None, prefer: str | None = None) -> Call[Job]:
    """A job: state, stages, progress, place in the queue, products, error.  With Prefer: wait=N the answer waits for
    the job's end; with If-None-Match besides, for its next change.
    """
    return Call(
        method="GET",
        path=path_of("/v1/jobs/{id}", {"id": id}),
        answer=Job,
        headers={"if-none-match": if_none_match, "prefer": prefer},
    )


def delete_job(id: str) -> Call[None]:
    """Forget a job that has ended, and its files. Other jobs keep what they share with it."""
    return Call(method="DELETE", path=path_of("/v1/jobs/{id}", {"id": id}), answer=None)


def cancel_job(id: str) -> Call[Job]:
    """Stop a job: at once while it waits, within one sampler step while it runs. Asking again changes nothing."""
    return Call(method="POST", path=path_of("/v1/jobs/{id}/cancel", {"id": id}), answer=Job)


def list_artifacts(id: str) -> Call[Manifest]:
    """The files that a job made so far, with their hashes. Stages that finished stay, whatever came after them."""
    return Call(method="GET", path=path_of("/v1/jobs/{id}/artifacts", {"id": id}), answer=Manifest)


def stream_job(id: str, *, last_event_id: str | None = None) -> Call[bytes]:
    """Follow a job. Each event is the whole job, so a client that reconnects late misses nothing that matters."""
    return Call(
        method="GET",
        path=path_of("/v1/jobs/{id}/events", {"id": id}),
        answer=bytes,
        headers={"last-event-id": last_event_id},
    )


def get_artifact(
    id: str,
    *,
    filename: str | None = None,
    range: str | None = None,
    if_range: str | None = None,
    if_none_match: str | None = None,
) -> Call[bytes]:
    """Download a file, or go on with a download."""
    return Call(
        method="GET",
        path=path_of("/v1/artifacts/{id}", {"id": id}),
        answer=bytes,
        query={"filename": filename},
        headers={"range": range, "if-range": if_range, "if-none-match": if_none_match},
    )


def head_artifact(id: str, *, if_none_match: str | None = None) -> Call[bytes]:
    """Size, hash and type of a file."""
    return Call(
        method="HEAD",
        path=path_of("/v1/artifacts/{id}", {"id": id}),
        answer=bytes,
        headers={"if-none-match": if_none_match},
    )


def create_link(body: LinkRequest) -> Call[Link]:
    """Sign an address, so that `<model-viewer src>` or a download manager can open it without a header.  The link
    ends with its time, with the key that asked for it, or with the file.
    """
    return Call(method="POST", path="/v1/links", answer=Link, body=body)


def get_spectrum(id: str) -> Call[Spectrum]:
    """What a spectrum is: frequencies, voxels, bounds, model. The coefficients are the artefact's bytes."""
    return Call(method="GET", path=path_of("/v1/spectra/{id}", {"id": id}), answer=Spectrum)


def get_wind(
    id: str, *, seed: int | None = None, gust: float | None = None, speed_m_s: float | None = None
) -> Call[TurbulentWind]:
    """Wind that never repeats, as a table of cosines: with the mode shapes it gives every voxel at any time."""
    return Call(
        method="GET",
        path=path_of("/v1/spectra/{id}/wind", {"id": id}),
        answer=TurbulentWind,
        query={"seed": seed, "gust": gust, "speed_m_s": speed_m_s},
    )


def interact(body: InteractRequest, *, accept: str | None = None) -> Call[Interact | bytes]:
    """Push a tree, and read how it swings."""
    return Call(method="POST", path="/v1/interact", answer=Interact | bytes, headers={"accept": accept}, body=body)


def get_asset_surface(id: str) -> Call[bytes]:
    """A mesh as it was read: metres, +Z up. Something to look at while its job runs."""
    return Call(method="GET", path=path_of("/v1/assets/{id}/surface", {"id": id}), answer=bytes)


def get_surface(id: str) -> Call[bytes]:
    """The source mesh, and the bones that turn in the wind and under a push."""
    return Call(method="GET", path=path_of("/v1/spectra/{id}/surface", {"id": id}), answer=bytes)


def get_modes(id: str, *, shapes: bool | None = None) -> Call[bytes]:
    """Mode shapes in 16 bits, and the bones that turn. With the coordinates of /v1/interact they give every voxel."""
    return Call(
        method="GET", path=path_of("/v1/spectra/{id}/modes", {"id": id}), answer=bytes, query={"shapes": shapes}
    )


def get_reach(id: str, *, seed_voxel: int, falloff_m: float) -> Call[bytes]:
    """How much each voxel takes part in a group of forces: w_g, a byte a voxel, in the order of the modes' coords."""
    return Call(
        method="GET",
        path=path_of("/v1/spectra/{id}/reach", {"id": id}),
        answer=bytes,
        query={"seed_voxel": seed_voxel, "falloff_m": falloff_m},
    )


def get_asset_points(id: str) -> Call[bytes]:
    """A splat or scan as it was read: metres, +Z up. Something to look at while its job runs."""
    return Call(method="GET", path=path_of("/v1/assets/{id}/points", {"id": id}), answer=bytes)


def list_webhook_endpoints() -> Call[EndpointList]:
    """All endpoints."""
    return Call(method="GET", path="/v1/webhook-endpoints", answer=EndpointList)


def create_webhook_endpoint(body: EndpointRequest) -> Call[EndpointWithSecret]:
    """Register an address that receives an event when a job ends. The signing secret is returned only here."""
    return Call(method="POST", path="/v1/webhook-endpoints", answer=EndpointWithSecret, body=body)


def delete_webhook_endpoint(id: str) -> Call[None]:
    """Delete an endpoint and its deliveries."""
    return Call(method="DELETE", path=path_of("/v1/webhook-endpoints/{id}", {"id": id}), answer=None)


def list_webhook_deliveries(id: str, *, cursor: str | None = None, limit: int | None = None) -> Call[DeliveryList]:
    """Deliveries to an endpoint, newest first, with every attempt."""
    return Call(
        method="GET",
        path=path_of("/v1/webhook-endpoints/{id}/deliveries", {"id": id}),
        answer=DeliveryList,
        query={"cursor": cursor, "limit": limit},
    )


def list_presets() -> Call[PresetList]:
    """The models that diffuse and animate jobs may name."""
    return Call(method="GET", path="/v1/presets", answer=PresetList)


def get_limits() -> Call[Limits]:
    """Sizes, numbers and formats that are allowed."""
    return Call(method="GET", path="/v1/limits", answer=Limits)


def get_usage() -> Call[Usage]:
    """Jobs that have not ended, bytes stored, the limits of the key, and what jobs took by month."""
    return Call(method="GET", path="/v1/usage", answer=Usage)


def get_liveness() -> Call[Live]:
    """Whether the process answers."""
    return Call(method="GET", path="/livez", answer=Live)


def get_readiness() -> Call[Ready]:
    """Whether jobs can be taken and run."""
    return Call(method="GET", path="/readyz", answer=Ready)


def get_metrics() -> Call[bytes]:
    """Counts, ages and durations for Prometheus."""
    return Call(method="GET", path="/metrics", answer=bytes)


def get_operations() -> Call[Ops]:
    """Queues, jobs by state, attempts, workers; over all keys, and nothing of any one."""
    return Call(method="GET", path="/v1/ops", answer=Ops)
