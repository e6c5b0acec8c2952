"""Routes for viewers and engines: meshes, points of clouds, bones, mode shapes, reach of a force."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query
from safetensors.numpy import save
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.interactive_tree import ForceGroup, Locality
from dynamictree.modal.modes import mode_metadata, mode_tensors
from dynamictree.request_model import LARGEST
from dynamictree.requests import Wind
from dynamictree.spectrum import bin_weights
from service.http.request_headers import SAFETENSORS
from service.http.routing import CACHED, Id, file_route
from service.interact.stored_trees import load_asset_cloud, load_asset_mesh, load_spectrum
from service.interact.tree_cache import ServedTree, served_tree
from service.services import OwnedDep

GZIP_LEVEL = 1
"""Level of gzip for tensors: the result is 5 % larger than with level 6 and takes a fifth of the time."""

router = APIRouter(prefix="/v1", tags=["spectra"])

MAX_POINTS = 200_000
"""Points of a preview (4 MB); larger clouds are thinned out."""

MIN_OPACITY = 0.1
"""Lowest opacity of a Gaussian in the preview; a fainter one alone is invisible."""

STEP = 6e-6
"""Quantization step of a bone's turn, times the tree's height over the bone's lever [rad]. Such steps together move a
vertex by up to 6.5e-5 of the height: measured on eight trees in winds of 5 and 20 m/s."""

ZERO = 1 << 15 | 1 << 7
"""16-bit code of no turn. It gives small turns equal high bytes, which compress well."""

BYTES = "application/octet-stream"

_SEEN = "safetensors; see docs/viewer.md"
_OF_ASSET = file_route(SAFETENSORS, _SEEN, "not-found", "conflict", "expired")


@router.get("/assets/{id}/surface", tags=["assets"], **_OF_ASSET)
def get_asset_surface(id: Id, owned: OwnedDep) -> Response:
    """Return a mesh as it was read, in metres and +Z up, to display while its job runs."""
    return _response(load_asset_mesh(owned, id), {}, None)


@router.get("/spectra/{id}/surface", **file_route(SAFETENSORS, _SEEN, "not-found", "expired"))
def get_surface(id: Id, owned: OwnedDep) -> Response:
    """Return the source mesh, and the bones that move it in wind and under forces."""
    tree = served_tree(owned, id)
    return _response(tree.mesh(), _motion(tree), load_spectrum(owned, id).wind)


@router.get(
    "/spectra/{id}/modes", **file_route(SAFETENSORS, "safetensors; see docs/interaction.md", "not-found", "expired")
)
def get_modes(
    id: Id,
    owned: OwnedDep,
    shapes: Annotated[bool, Query(description="False omits data that …/surface has too")] = True,
) -> Response:
    """Return mode shapes in 16 bits, and bones. With coordinates of /v1/interact, they displace every voxel."""
    tree = served_tree(owned, id).with_rig()
    tensors = mode_tensors(tree.system, tree.bones, tree.joints, shapes=shapes)
    if shapes:
        tensors["lean_m"] = load_spectrum(owned, id).coefficients[:, 0].real
    return packed_tensors(tensors, mode_metadata(tree.system) | {"spectrum_id": id})


@router.get("/spectra/{id}/reach", **file_route(BYTES, "One byte per voxel: 255 w", "not-found", "expired"))
def get_reach(
    id: Id,
    owned: OwnedDep,
    seed_voxel: Annotated[int, Query(ge=0, description="Row of the locality's voxel")],
    falloff_m: Annotated[
        float, Query(gt=0, le=LARGEST, allow_inf_nan=False, description="Falloff of the locality [m]")
    ],
) -> Response:
    """Return each voxel's weight w_g in a group of forces, a byte per voxel, in the order of the modes' coords."""
    place = Locality(seed_voxel=seed_voxel, falloff_m=falloff_m)
    (weights,) = served_tree(owned, id).with_rig().weights([ForceGroup(locality=place)])
    return Response(np.rint(weights * 255).astype(np.uint8).tobytes(), 200, CACHED, BYTES)


@router.get("/assets/{id}/points", tags=["assets"], **_OF_ASSET)
def get_asset_points(id: Id, owned: OwnedDep) -> Response:
    """Return points of a splat or scan as it was read, in metres and +Z up, to display while its job runs."""
    return packed_tensors(point_tensors(load_asset_cloud(owned, id)), {"format": "tree-points", "version": "1"})


def point_tensors(cloud: GaussianCloud) -> dict[str, np.ndarray]:
    """Return positions [m], sRGB colours and radii [m] of at most `MAX_POINTS` Gaussians, evenly chosen."""
    visible = np.flatnonzero(cloud.opacity >= MIN_OPACITY)
    if not len(visible):
        visible = np.arange(cloud.num_gaussians)
    step = -(-len(visible) // MAX_POINTS)
    rows = visible[::step]
    colours = np.clip(0.5 + SH_0 * cloud.sh[rows, 0], 0, 1)
    return {
        "points": cloud.means[rows].astype(np.float32),
        "colours": np.rint(255 * colours).astype(np.uint8),
        "radius_m": (1.5 * np.sqrt(step) * np.median(cloud.scales[rows], axis=1)).astype(np.float32),
    }


def mesh_tensors(mesh: TriangleMesh) -> dict[str, np.ndarray]:
    """Return the tensors from which a viewer draws a mesh."""
    tensors: dict[str, np.ndarray] = {"vertices": mesh.vertices, "faces": mesh.faces}
    for name in ("uv", "vertex_colors", "face_material"):
        if getattr(mesh.look, name) is not None:
            tensors[name] = getattr(mesh.look, name)
    if (still := mesh.still_vertices).any():
        tensors["still"] = still.view(np.uint8)
    for index, material in enumerate(mesh.look.materials):
        if material.texture_png is not None:
            tensors[f"texture_{index}"] = np.frombuffer(material.texture_png, np.uint8)
    return tensors


def _motion(tree: ServedTree) -> dict[str, np.ndarray]:
    rig, mesh, flutter = tree.rig(), tree.mesh(), tree.flutter()
    weights = bin_weights(rig.turns.shape[1], rig.num_frames)[:, None]  # bin 0 is the lean, the others φ_k = 2 c_k
    parts = np.stack([(rig.turns * weights).real, (rig.turns * weights).imag], axis=-1)
    levers_m = np.maximum(rig.levers_m(mesh.vertices), 0.001 * mesh.height_m)
    step_rad = np.maximum(STEP * mesh.height_m / levers_m, np.abs(parts).max(axis=(1, 2, 3)) / (0xFFFF - ZERO))
    steps = np.rint(parts / step_rad[:, None, None, None]) + ZERO
    return {
        "turn_shapes": np.moveaxis(steps.astype("<u2")[..., None].view(np.uint8), -1, 0),
        "turn_step_rad": step_rad.astype(np.float32),
        "turn_parent": rig.skeleton.parent,
        "turn_foot_m": rig.skeleton.foot_m,
        "turn_bone": rig.vertices.rows[:, 0],
        "turn_share": rig.vertices.shares[:, 1],
        **flutter.tensors,
    }


def _response(mesh: TriangleMesh, motion: dict[str, np.ndarray], wind: Wind | None) -> Response:
    fields = ("name", "base_color", "alpha_cutoff", "double_sided")
    materials = [{name: getattr(material, name) for name in fields} for material in mesh.look.materials]
    planes = {"turn_shapes": ZERO} if motion else {}
    objects = {"materials": materials, "planes": planes, "wind": wind and asdict(wind)}
    metadata = {"format": "tree-surface", "version": "3", "unit": "m", "up_axis": "+Z"}
    metadata |= {name: json.dumps(value) for name, value in objects.items()}
    return packed_tensors(mesh_tensors(mesh) | motion, metadata)


class PackedResponse(Response):
    """Response that is compressed per request; a large one is compressed in a thread, outside the event loop."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response."""
        await GZipMiddleware(super().__call__, compresslevel=GZIP_LEVEL)(scope, receive, send)


def packed_tensors(tensors: Mapping[str, np.ndarray], metadata: dict[str, str]) -> PackedResponse:
    """Return tensors as a safetensors response. Clients may cache it, since spectra and assets never change."""
    content = save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, metadata)
    return PackedResponse(content, 200, CACHED, SAFETENSORS)
