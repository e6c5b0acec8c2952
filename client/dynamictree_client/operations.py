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
    """Return the supported versions and extensions of tus."""
    return Call(method="OPTIONS", path="/v1/uploads", answer=None)


def create_upload(
    content: bytes,
    *,
    tus_resumable: str | None = None,
    upload_length: str | None = None,
    upload_metadata: str | None = None,
    content_type: str | None = None,
) -> Call[None]:
    """Create an upload; the request may contain its first bytes."""
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
    """Return the current offset of an upload."""
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
    """Return an upload: state, size, asset. Prefer: wait=N waits until the asset exists or the upload has failed."""
    return Call(method="GET", path=path_of("/v1/uploads/{id}", {"id": id}), answer=Upload, headers={"prefer": prefer})


def delete_upload(id: str, *, tus_resumable: str | None = None) -> Call[None]:
    """Delete an upload. An asset that was made from it remains."""
    return Call(
        method="DELETE",
        path=path_of("/v1/uploads/{id}", {"id": id}),
        answer=None,
        headers={"Tus-Resumable": tus_resumable},
    )


def create_upload_parts(id: str) -> Call[UploadParts]:
    """Return URLs in object storage to PUT the missing bytes to; then PATCH at the full length without a body.
    Status 409 if uploads are stored in a folder, or the setting `presigned_links` is off.
    """
    return Call(method="POST", path=path_of("/v1/uploads/{id}/parts", {"id": id}), answer=UploadParts)


def create_asset(body: dict[str, Any]) -> Call[Asset | Upload]:
    """Create an asset from sent files (a mesh, splat, scan, photos or a film), from uploads, or from a URL."""
    return Call(method="POST", path="/v1/assets", answer=Asset | Upload, body=body)


def get_asset(id: str) -> Call[Asset]:
    """Return an asset: its files and a summary of their content."""
    return Call(method="GET", path=path_of("/v1/assets/{id}", {"id": id}), answer=Asset)


def delete_asset(id: str) -> Call[None]:
    """Delete an asset. Products that were made from it remain until they expire."""
    return Call(method="DELETE", path=path_of("/v1/assets/{id}", {"id": id}), answer=None)


def create_job(
    body: ReconstructRequest | VoxelizeRequest | DiffuseRequest | AnimateRequest, *, idempotency_key: str | None = None
) -> Call[Job]:
    """Create a job for voxels, a spectrum, a motion, or a mesh from photos. Earlier stages run first or are cached."""
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
    """List jobs, newest first."""
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
    """Create a new job with the request of a job that has ended; finished stages are taken from the cache."""
    return Call(method="POST", path=path_of("/v1/jobs/{id}/retry", {"id": id}), answer=Job)


def get_job(id: str, *, if_none_match: str | None = None, prefer: str | None = None) -> Call[Job]:
    """Return a job: state, stages, progress, queue position, products, error.  With Prefer: wait=N, the response
    waits for the job's end; with If-None-Match too, for its next change.
    """
    return Call(
        method="GET",
        path=path_of("/v1/jobs/{id}", {"id": id}),
        answer=Job,
        headers={"if-none-match": if_none_match, "prefer": prefer},
    )


def delete_job(id: str) -> Call[None]:
    """Delete a job that has ended, and its files. Files that it shares with other jobs remain."""
    return Call(method="DELETE", path=path_of("/v1/jobs/{id}", {"id": id}), answer=None)


def cancel_job(id: str) -> Call[Job]:
    """Cancel a job: at once if it waits, within one sampler step if it runs. A repeated request changes nothing."""
    return Call(method="POST", path=path_of("/v1/jobs/{id}/cancel", {"id": id}), answer=Job)


def list_artifacts(id: str) -> Call[Manifest]:
    """List the files that a job has made so far, with hashes. Files of finished stages remain if a later one fails."""
    return Call(method="GET", path=path_of("/v1/jobs/{id}/artifacts", {"id": id}), answer=Manifest)


def stream_job(id: str, *, last_event_id: str | None = None) -> Call[bytes]:
    """Stream the changes of a job. Each event is the whole job, so a client that reconnects loses nothing."""
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
    """Download a file, or resume a download."""
    return Call(
        method="GET",
        path=path_of("/v1/artifacts/{id}", {"id": id}),
        answer=bytes,
        query={"filename": filename},
        headers={"range": range, "if-range": if_range, "if-none-match": if_none_match},
    )


def head_artifact(id: str, *, if_none_match: str | None = None) -> Call[bytes]:
    """Return the size, hash and type of a file in headers."""
    return Call(
        method="HEAD",
        path=path_of("/v1/artifacts/{id}", {"id": id}),
        answer=bytes,
        headers={"if-none-match": if_none_match},
    )


def create_link(body: LinkRequest) -> Call[Link]:
    """Sign a path, so that `<model-viewer src>` or a download manager can open it without a header.  The link
    expires after its lifetime, with the key that created it, or with the file.
    """
    return Call(method="POST", path="/v1/links", answer=Link, body=body)


def get_spectrum(id: str) -> Call[Spectrum]:
    """Return properties of a spectrum: frequencies, voxels, bounds, model. Its coefficients are in the artifact."""
    return Call(method="GET", path=path_of("/v1/spectra/{id}", {"id": id}), answer=Spectrum)


def get_wind(
    id: str, *, seed: int | None = None, gust: float | None = None, speed_m_s: float | None = None
) -> Call[TurbulentWind]:
    """Return wind that never repeats, as sums of cosines; with mode shapes, they move every voxel at any time."""
    return Call(
        method="GET",
        path=path_of("/v1/spectra/{id}/wind", {"id": id}),
        answer=TurbulentWind,
        query={"seed": seed, "gust": gust, "speed_m_s": speed_m_s},
    )


def interact(body: InteractRequest, *, accept: str | None = None) -> Call[Interact | bytes]:
    """Apply forces to a tree, and return its response."""
    return Call(method="POST", path="/v1/interact", answer=Interact | bytes, headers={"accept": accept}, body=body)


def get_asset_surface(id: str) -> Call[bytes]:
    """Return a mesh as it was read, in metres and +Z up, to display while its job runs."""
    return Call(method="GET", path=path_of("/v1/assets/{id}/surface", {"id": id}), answer=bytes)


def get_surface(id: str) -> Call[bytes]:
    """Return the source mesh, and the bones that move it in wind and under forces."""
    return Call(method="GET", path=path_of("/v1/spectra/{id}/surface", {"id": id}), answer=bytes)


def get_modes(id: str, *, shapes: bool | None = None) -> Call[bytes]:
    """Return mode shapes in 16 bits, and bones. With coordinates of /v1/interact, they displace every voxel."""
    return Call(
        method="GET", path=path_of("/v1/spectra/{id}/modes", {"id": id}), answer=bytes, query={"shapes": shapes}
    )


def get_reach(id: str, *, seed_voxel: int, falloff_m: float) -> Call[bytes]:
    """Return each voxel's weight w_g in a group of forces, a byte per voxel, in the order of the modes' coords."""
    return Call(
        method="GET",
        path=path_of("/v1/spectra/{id}/reach", {"id": id}),
        answer=bytes,
        query={"seed_voxel": seed_voxel, "falloff_m": falloff_m},
    )


def get_asset_points(id: str) -> Call[bytes]:
    """Return points of a splat or scan as it was read, in metres and +Z up, to display while its job runs."""
    return Call(method="GET", path=path_of("/v1/assets/{id}/points", {"id": id}), answer=bytes)


def list_webhook_endpoints() -> Call[EndpointList]:
    """List all endpoints."""
    return Call(method="GET", path="/v1/webhook-endpoints", answer=EndpointList)


def create_webhook_endpoint(body: EndpointRequest) -> Call[EndpointWithSecret]:
    """Register an address that receives an event when a job ends. The signing secret is returned only here."""
    return Call(method="POST", path="/v1/webhook-endpoints", answer=EndpointWithSecret, body=body)


def delete_webhook_endpoint(id: str) -> Call[None]:
    """Delete an endpoint and its deliveries."""
    return Call(method="DELETE", path=path_of("/v1/webhook-endpoints/{id}", {"id": id}), answer=None)


def list_webhook_deliveries(id: str, *, cursor: str | None = None, limit: int | None = None) -> Call[DeliveryList]:
    """List deliveries to an endpoint, newest first, with every attempt."""
    return Call(
        method="GET",
        path=path_of("/v1/webhook-endpoints/{id}/deliveries", {"id": id}),
        answer=DeliveryList,
        query={"cursor": cursor, "limit": limit},
    )


def list_presets() -> Call[PresetList]:
    """List the models that diffuse and animate jobs can use."""
    return Call(method="GET", path="/v1/presets", answer=PresetList)


def get_limits() -> Call[Limits]:
    """Return limits of sizes and numbers, and supported formats."""
    return Call(method="GET", path="/v1/limits", answer=Limits)


def get_usage() -> Call[Usage]:
    """Return active jobs, stored bytes, the limits of the key, and resource use by month."""
    return Call(method="GET", path="/v1/usage", answer=Usage)


def get_liveness() -> Call[Live]:
    """Return status 200 if the process responds."""
    return Call(method="GET", path="/livez", answer=Live)


def get_readiness() -> Call[Ready]:
    """Return whether the service can accept and run jobs."""
    return Call(method="GET", path="/readyz", answer=Ready)


def get_metrics() -> Call[bytes]:
    """Return counts, ages and durations for Prometheus."""
    return Call(method="GET", path="/metrics", answer=bytes)


def get_operations() -> Call[Ops]:
    """Return queues, jobs by state, attempts and workers, as totals over all keys."""
    return Call(method="GET", path="/v1/ops", answer=Ops)
