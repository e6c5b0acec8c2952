"""/v1/spectra/{id}/modes and /reach: what an engine or a viewer needs to move the tree itself."""

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query
from fastapi.responses import Response

from dynamictree.modal.interactive_tree import ForceGroup, Locality
from dynamictree.modal.modes import mode_metadata, mode_tensors
from dynamictree.request_model import LARGEST
from service.http.packing import packed_tensors
from service.http.request_headers import SAFETENSORS
from service.http.routing import CACHED, Id, file_route
from service.interact.stored_trees import load_spectrum
from service.interact.tree_cache import served_tree
from service.services import OwnedDep

router = APIRouter(prefix="/v1/spectra", tags=["spectra"])

BYTES = "application/octet-stream"


@router.get("/{id}/modes", **file_route(SAFETENSORS, "safetensors; see docs/interaction.md", "not-found", "expired"))
def get_modes(
    id: Id,
    owned: OwnedDep,
    shapes: Annotated[bool, Query(description="false leaves out what the bones of …/surface say as well")] = True,
) -> Response:
    """Mode shapes in 16 bits, and the bones that turn. With the coordinates of /v1/interact they give every voxel."""
    tree = served_tree(owned, id).with_rig()
    tensors = mode_tensors(tree.system, tree.bones, tree.joints, shapes=shapes)
    if shapes:
        tensors["lean_m"] = load_spectrum(owned, id).coefficients[:, 0].real
    return packed_tensors(tensors, mode_metadata(tree.system) | {"spectrum_id": id})


@router.get("/{id}/reach", **file_route(BYTES, "one byte a voxel: 255 w", "not-found", "expired"))
def get_reach(
    id: Id,
    owned: OwnedDep,
    seed_voxel: Annotated[int, Query(ge=0, description="of the group's locality")],
    falloff_m: Annotated[
        float, Query(gt=0, le=LARGEST, allow_inf_nan=False, description="of the group's locality [m]")
    ],
) -> Response:
    """How much each voxel takes part in a group of forces: w_g, a byte a voxel, in the order of the modes' coords."""
    place = Locality(seed_voxel=seed_voxel, falloff_m=falloff_m)
    (weights,) = served_tree(owned, id).with_rig().weights([ForceGroup(locality=place)])
    content = np.rint(weights * 255).astype(np.uint8).tobytes()
    return Response(content, 200, CACHED, BYTES)
