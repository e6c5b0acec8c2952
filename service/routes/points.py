"""The points of a splat or scan for a program that draws it at rest, while its job runs."""

import numpy as np
from fastapi import APIRouter
from fastapi.responses import Response
from safetensors.numpy import save

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from service.http.packing import PackedResponse
from service.http.request_headers import SAFETENSORS
from service.http.routing import CACHED, Id, file_of, refusals
from service.interact.stored_trees import load_asset_cloud
from service.services import OwnedDep

router = APIRouter(prefix="/v1", tags=["assets"])

MAX_POINTS = 200_000
"""More are thinned out: a preview, 4 MB."""

FAINTEST = 0.1
"""Gaussians of a lower opacity are left out: alone they are not seen."""


@router.get(
    "/assets/{id}/points",
    operation_id="getAssetPoints",
    response_class=Response,
    responses=refusals("not-found", "conflict", "expired") | file_of(SAFETENSORS, "safetensors; see docs/viewer.md"),
)
def get_asset_points(id: Id, owned: OwnedDep) -> Response:
    """A splat or scan as it was read: metres, +Z up. Something to look at while its job runs."""
    content = save(point_tensors(load_asset_cloud(owned, id)), {"format": "tree-points", "version": "1"})
    return PackedResponse(content, 200, CACHED, SAFETENSORS)


def point_tensors(cloud: GaussianCloud) -> dict[str, np.ndarray]:
    """Places [m], sRGB colours and radii [m] of at most `MAX_POINTS` Gaussians, evenly chosen."""
    visible = np.flatnonzero(cloud.opacity >= FAINTEST)
    if not len(visible):
        visible = np.arange(cloud.num_gaussians)
    step = -(-len(visible) // MAX_POINTS)
    rows = visible[::step]
    colours = np.clip(0.5 + SH_0 * cloud.sh[rows, 0], 0, 1)
    return {
        "points": np.ascontiguousarray(cloud.means[rows], np.float32),
        "colours": np.rint(255 * colours).astype(np.uint8),
        "radius_m": (1.5 * np.sqrt(step) * np.median(cloud.scales[rows], axis=1)).astype(np.float32),
    }
