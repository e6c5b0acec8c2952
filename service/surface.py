"""The source mesh for a program that draws it: as it was uploaded, and with the motion of its vertices."""

import json
from io import BytesIO
from typing import Any

import numpy as np
from fastapi import APIRouter
from fastapi.responses import Response
from safetensors.numpy import save

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.modes import quantised
from dynamictree.modal.surface import BoneAttachment
from dynamictree.spectrum import bin_weights
from jobs.errors import ConflictError, GoneError
from service.accept import SAFETENSORS
from service.context import Context, Ctx
from service.routing import Id, refusals
from service.spectra import load_spectrum
from service.trees import bone_ties, ready_tree, vertex_ties, with_mesh

router = APIRouter(prefix="/v1", tags=["spectra"])

MAX_OWN_SHAPES = 150_000
"""Vertices up to which each gets its own spectrum (192 bytes at K = 16); larger meshes are tied to the voxels."""

MAX_HELD = 40_000
"""Vertices up to which edges are kept from stretching as in the products: a second for 8,000."""

BONES = 4
"""A vertex keeps its strongest ones: what a vertex shader takes in one attribute."""

TIES = 4

_FILE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "safetensors; see docs/viewer.md",
        "content": {SAFETENSORS: {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.get(
    "/assets/{id}/surface",
    operation_id="getAssetSurface",
    tags=["assets"],
    response_class=Response,
    responses=refusals("not-found", "conflict", "expired") | _FILE,
)
def get_asset_surface(id: Id, context: Ctx) -> Response:
    """A mesh as it was read: metres, +Z up. Something to look at while its job runs."""
    from dynamictree.formats.mesh_bundle import read_mesh_bundle

    asset = context.store.asset(id)
    if asset.kind != "mesh" or asset.prepared is None:
        raise ConflictError(f"asset {id} is no mesh but {asset.kind}; a job makes its mesh")
    try:
        mesh = read_mesh_bundle(BytesIO(b"".join(context.artifacts.read(asset.prepared.sha256))))
    except FileNotFoundError as error:
        raise GoneError(f"the mesh of asset {id} was removed; upload it again") from error
    return _response(mesh_tensors(mesh), mesh)


@router.get(
    "/spectra/{id}/surface",
    operation_id="getSurface",
    response_class=Response,
    responses=refusals("not-found", "expired") | _FILE,
)
def get_surface(id: Id, context: Ctx) -> Response:
    """The source mesh, its vertices' motion in 16 bits, and the bones that carry them."""
    ready = ready_tree(context, context.trees, id)
    mesh = with_mesh(context, ready, id)
    tensors = mesh_tensors(mesh) | _bone_tensors(bone_ties(ready, mesh)) | _motion_tensors(context, id, mesh)
    return _response(tensors, mesh)


def mesh_tensors(mesh: TriangleMesh) -> dict[str, np.ndarray]:
    """What a mesh is drawn from."""
    tensors: dict[str, np.ndarray] = {"vertices": mesh.vertices, "faces": mesh.faces}
    for name in ("uv", "vertex_colors", "face_material"):
        if getattr(mesh, name) is not None:
            tensors[name] = getattr(mesh, name)
    for index, material in enumerate(mesh.materials):
        if material.texture_png is not None:
            tensors[f"texture_{index}"] = np.frombuffer(material.texture_png, np.uint8)
    return tensors


def _motion_tensors(context: Context, spectrum_id: str, mesh: TriangleMesh) -> dict[str, np.ndarray]:
    from dynamictree.voxel.inextensible import hold_lengths  # brings numba

    ties = vertex_ties(ready_tree(context, context.trees, spectrum_id), mesh)
    if mesh.num_vertices > MAX_OWN_SHAPES:
        return _strongest(ties.rows, ties.weights)
    spectrum = load_spectrum(context, spectrum_id)
    coefficients = ties.apply(spectrum.coefficients)  # [N, K, 3]
    if mesh.num_vertices <= MAX_HELD:
        coefficients = hold_lengths(mesh, coefficients, spectrum.grid.voxel_size_m)  # as the products have them
    weights = bin_weights(spectrum.num_frequencies, spectrum.num_frames)
    shapes, scale = quantised(coefficients * weights[:, None])  # bin 0 is the lean, the others φ_k = 2 c_k
    return {"shapes": shapes, "scale_m": scale}


def _strongest(rows: np.ndarray, weights: np.ndarray) -> dict[str, np.ndarray]:
    kept = np.argsort(-weights, axis=1, kind="stable")[:, :TIES]
    return {
        "tie_rows": np.take_along_axis(rows, kept, axis=1).astype(np.int32),
        "tie_weights": _bytes(np.take_along_axis(weights, kept, axis=1)),
    }


def _bone_tensors(attachment: BoneAttachment) -> dict[str, np.ndarray]:
    kept = np.argsort(-attachment.weights, axis=1, kind="stable")[:, :BONES]
    return {
        "bone_rows": np.take_along_axis(attachment.rows, kept, axis=1).astype(np.uint16),
        "bone_weights": _bytes(np.take_along_axis(attachment.weights, kept, axis=1)),
    }


def _bytes(weights: np.ndarray) -> np.ndarray:
    """Weights that sum to 1 as bytes that sum to 255; what rounding leaves over goes to the first."""
    scaled = np.rint(255 * weights / weights.sum(axis=1, keepdims=True)).astype(np.int32)
    scaled[:, 0] += 255 - scaled.sum(axis=1)
    result: np.ndarray = scaled.astype(np.uint8)
    return result


def _response(tensors: dict[str, np.ndarray], mesh: TriangleMesh) -> Response:
    materials = [
        {
            "name": material.name,
            "base_color": material.base_color,
            "alpha_cutoff": material.alpha_cutoff,
            "double_sided": material.double_sided,
        }
        for material in mesh.materials
    ]
    metadata = {"format": "tree-surface", "version": "1", "unit": "m", "up_axis": "+Z"}
    metadata["materials"] = json.dumps(materials)
    content = save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, metadata)
    return Response(content, 200, {"Cache-Control": "private, max-age=86400"}, SAFETENSORS)
