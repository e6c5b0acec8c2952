"""The source for a viewer: a mesh as uploaded and with the motion of its vertices, the points of a cloud."""

import json

import numpy as np
from fastapi import APIRouter
from fastapi.responses import Response

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.modes import quantised
from dynamictree.spectrum import bin_weights
from service.http.packing import packed_tensors
from service.http.request_headers import SAFETENSORS
from service.http.routing import Id, file_route
from service.interact.stored_trees import load_asset_cloud, load_asset_mesh
from service.interact.tree_cache import ServedTree, served_tree
from service.services import OwnedDep

router = APIRouter(prefix="/v1", tags=["spectra"])

MAX_POINTS = 200_000
"""More are thinned out: a preview, 4 MB."""

FAINTEST = 0.1
"""Gaussians of a lower opacity are left out: alone they are not seen."""

_SEEN = "safetensors; see docs/viewer.md"
_OF_ASSET = file_route(SAFETENSORS, _SEEN, "not-found", "conflict", "expired")


@router.get("/assets/{id}/surface", tags=["assets"], **_OF_ASSET)
def get_asset_surface(id: Id, owned: OwnedDep) -> Response:
    """A mesh as it was read: metres, +Z up. Something to look at while its job runs."""
    mesh = load_asset_mesh(owned, id)
    return _response(mesh_tensors(mesh), mesh)


@router.get("/spectra/{id}/surface", **file_route(SAFETENSORS, _SEEN, "not-found", "expired"))
def get_surface(id: Id, owned: OwnedDep) -> Response:
    """The source mesh, and the bones that turn in the wind and under a push."""
    tree = served_tree(owned, id)
    mesh = tree.mesh()
    return _response(mesh_tensors(mesh) | _motion(tree), mesh)


@router.get("/assets/{id}/points", tags=["assets"], **_OF_ASSET)
def get_asset_points(id: Id, owned: OwnedDep) -> Response:
    """A splat or scan as it was read: metres, +Z up. Something to look at while its job runs."""
    return packed_tensors(point_tensors(load_asset_cloud(owned, id)), {"format": "tree-points", "version": "1"})


def point_tensors(cloud: GaussianCloud) -> dict[str, np.ndarray]:
    """Places [m], sRGB colours and radii [m] of at most `MAX_POINTS` Gaussians, evenly chosen."""
    visible = np.flatnonzero(cloud.opacity >= FAINTEST)
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
    """Tensors from which a viewer draws a mesh."""
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
    rig = tree.rig()
    weights = bin_weights(rig.turns.shape[1], rig.num_frames)[:, None]  # bin 0 is the lean, the others φ_k = 2 c_k
    turns, step_rad = quantised(rig.turns * weights)
    return {
        "turn_shapes": turns,
        "turn_scale_rad": step_rad,
        "turn_parent": rig.skeleton.parent,
        "turn_foot_m": rig.skeleton.foot_m,
        "turn_direction": rig.skeleton.directions,
        "turn_bone": rig.vertices.rows[:, 0],
        "turn_share": rig.vertices.shares[:, 1],
    }


def _response(tensors: dict[str, np.ndarray], mesh: TriangleMesh) -> Response:
    fields = ("name", "base_color", "alpha_cutoff", "double_sided")
    materials = [{name: getattr(material, name) for name in fields} for material in mesh.look.materials]
    metadata = {"format": "tree-surface", "version": "1", "unit": "m", "up_axis": "+Z"}
    metadata["materials"] = json.dumps(materials)
    return packed_tensors(tensors, metadata)
