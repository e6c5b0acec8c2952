"""The source for a viewer: a mesh as uploaded and with the motion of its vertices, the points of a cloud."""

import json

import numpy as np
from fastapi import APIRouter
from fastapi.responses import Response
from jaxtyping import Float, Float64, Int32, Int64, Integer
from safetensors.numpy import save

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.modes import quantised
from dynamictree.spectrum import bin_weights
from dynamictree.voxel.grid import VoxelGrid
from service.http.packing import PackedResponse
from service.http.request_headers import SAFETENSORS
from service.http.routing import CACHED, Id, file_of, refusals
from service.interact.ready_tree import ReadyTree, bone_ties
from service.interact.stored_trees import load_asset_cloud, load_asset_mesh
from service.interact.tree_cache import ready_tree, rig_for, with_mesh
from service.services import Owned, OwnedDep

router = APIRouter(prefix="/v1", tags=["spectra"])

BONES = 4
"""A vertex keeps its strongest ones: what a vertex shader takes in one attribute."""

MAX_TIED = 20_000
"""Vertices up to which a push bends each as the service does: a few seconds of solving. Others follow near voxels."""

MAX_POINTS = 200_000
"""More are thinned out: a preview, 4 MB."""

FAINTEST = 0.1
"""Gaussians of a lower opacity are left out: alone they are not seen."""

_FILE = file_of(SAFETENSORS, "safetensors; see docs/viewer.md")


@router.get(
    "/assets/{id}/surface",
    operation_id="getAssetSurface",
    tags=["assets"],
    response_class=Response,
    responses=refusals("not-found", "conflict", "expired") | _FILE,
)
def get_asset_surface(id: Id, owned: OwnedDep) -> Response:
    """A mesh as it was read: metres, +Z up. Something to look at while its job runs."""
    mesh = load_asset_mesh(owned, id)
    return _response(mesh_tensors(mesh), mesh)


@router.get(
    "/spectra/{id}/surface",
    operation_id="getSurface",
    response_class=Response,
    responses=refusals("not-found", "expired") | _FILE,
)
def get_surface(id: Id, owned: OwnedDep) -> Response:
    """The source mesh, the bones that turn in the wind, and those that carry it under a push."""
    ready = ready_tree(owned, id)
    mesh = with_mesh(owned, ready, id)
    return _response(mesh_tensors(mesh) | _motion(owned, id, ready, mesh), mesh)


@router.get(
    "/assets/{id}/points",
    operation_id="getAssetPoints",
    tags=["assets"],
    response_class=Response,
    responses=refusals("not-found", "conflict", "expired") | _FILE,
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


def _motion(owned: Owned, spectrum_id: str, ready: ReadyTree, mesh: TriangleMesh) -> dict[str, np.ndarray]:
    rig = rig_for(owned, ready, spectrum_id)
    weights = bin_weights(rig.turns.shape[1], rig.num_frames)[:, None]  # bin 0 is the lean, the others φ_k = 2 c_k
    turns, step_rad = quantised(rig.turns * weights)
    rows, shares = _pushed(ready, mesh)
    return {
        "bone_rows": rows.astype(np.uint16),
        "bone_weights": _bytes(shares),
        "turn_shapes": turns,
        "turn_scale_rad": step_rad,
        "turn_parent": rig.skeleton.parent,
        "turn_foot_m": rig.skeleton.foot_m,
        "turn_direction": rig.skeleton.directions,
        "turn_bone": rig.vertices.rows[:, 0],
        "turn_share": rig.vertices.shares[:, 1],
    }


def _pushed(ready: ReadyTree, mesh: TriangleMesh) -> tuple[Integer[np.ndarray, "N b"], Float[np.ndarray, "N b"]]:
    """Bones that carry each vertex under a push, the strongest first, and their weights; 0 for what is no plant."""
    if mesh.num_vertices <= MAX_TIED:
        carried = bone_ties(ready, mesh)
        strongest = np.argsort(-carried.weights, axis=1, kind="stable")[:, :BONES]
        rows, weights = (np.take_along_axis(values, strongest, axis=1) for values in (carried.rows, carried.weights))
        return rows, weights
    grid, tree = ready.tree.system.grid, ready.tree.system.tree
    far, near = _nearest_voxels(grid, tree, mesh)
    weights = np.where(mesh.still_vertices[:, None], 0, 1 / (far**2 + grid.voxel_size_m**2))
    return ready.tree.bones.bone_of_voxel[near], weights


def _nearest_voxels(
    grid: VoxelGrid, tree: Int32[np.ndarray, " V"] | None, mesh: TriangleMesh
) -> tuple[Float64[np.ndarray, "N b"], Int64[np.ndarray, "N b"]]:
    """Distances [m] and rows of the voxels next to each vertex; of several trees those of its own."""
    from scipy.spatial import cKDTree  # not at start: half a second

    every = [(np.arange(mesh.num_vertices), np.arange(len(grid)))]
    if tree is not None and mesh.face_tree is not None:
        every = [
            (np.unique(mesh.faces[mesh.face_tree == each]), np.flatnonzero(tree == each)) for each in np.unique(tree)
        ]
    far, rows = np.zeros((mesh.num_vertices, BONES)), np.zeros((mesh.num_vertices, BONES), np.int64)
    for vertices, own in every:
        distance, index = cKDTree(grid.centres_m[own]).query(mesh.vertices[vertices], k=np.arange(1, BONES + 1))
        far[vertices] = distance  # infinite where there are fewer
        rows[vertices] = own[np.minimum(index, len(own) - 1)]
    return far, rows


def _bytes(weights: np.ndarray) -> np.ndarray:
    """Weights as bytes that sum to 255; what rounding leaves over goes to the first. All 0 where all are 0."""
    total = weights.sum(axis=1, keepdims=True)
    scaled = np.rint(255 * weights / np.where(total > 0, total, 1)).astype(np.int32)
    scaled[:, 0] += np.where(total[:, 0] > 0, 255, 0) - scaled.sum(axis=1)
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
        for material in mesh.look.materials
    ]
    metadata = {"format": "tree-surface", "version": "1", "unit": "m", "up_axis": "+Z"}
    metadata["materials"] = json.dumps(materials)
    content = save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, metadata)
    return PackedResponse(content, 200, CACHED, SAFETENSORS)
