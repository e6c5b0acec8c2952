"""Choose the mesh whose rendered colours match held-out photos best."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float32
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import render_on_cpu
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.picture_loss import psnr
from dynamictree.reconstruct.report import downscaled_picture
from dynamictree.reconstruct.views import View
from dynamictree.render import Renderer, RenderSettings

NEAR_SHARE = 0.02  # share of the region's radius; farthest distance of a mesh's Gaussian from it


def best_mesh(meshes: Mapping[str, TriangleMesh], scene: GaussianCloud, views: Sequence[View], radius: float) -> str:
    """Return the name of the mesh that matches the photos best.

    Each mesh is rendered with its vertex colours in front of the scene without the Gaussians of any mesh. The PSNR is
    measured where a mesh or those Gaussians are visible, so missing parts cost as much as superfluous ones.

    Args:
        meshes: candidates, at least one, with vertex colours, in the frame of the scene and the cameras; the first is
            chosen unless another is better by half a decibel.
        scene: all Gaussians.
        views: held-out photos.
        radius: radius of the region.
    """
    if len(meshes) == 1:
        return next(iter(meshes))
    own = np.any([gaussians_near_mesh(scene, mesh, radius=radius) for mesh in meshes.values()], axis=0)
    scores: dict[str, list[float]] = {name: [] for name in meshes}
    for view in views:
        photo = downscaled_picture(view.image, 320).astype(np.float32) / 255
        height, width = photo.shape[:2]
        drawn = {name: _render_mesh(mesh, view, width, height) for name, mesh in meshes.items()}
        behind = render_on_cpu(scene.subset(~own), view.camera, width=width, height=height).over((0.0, 0.0, 0.0))
        counted = render_on_cpu(scene.subset(own), view.camera, width=width, height=height).alpha > 0.5
        counted |= np.any([there for _, there in drawn.values()], axis=0)
        for name, (color, there) in drawn.items():
            picture = np.where(there[..., None], color, behind.astype(np.float32) / 255)
            scores[name].append(psnr(picture[counted], photo[counted]) if counted.any() else 0.0)
    first, least_gain_db = next(iter(meshes)), 0.5
    mean = {name: float(np.mean(values)) - (0 if name == first else least_gain_db) for name, values in scores.items()}
    return max(mean, key=lambda name: mean[name])


def _render_mesh(
    mesh: TriangleMesh, view: View, width: int, height: int
) -> tuple[Float32[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Render the mesh in its own colours, without light; return the picture and a mask."""
    assert mesh.look.vertex_colors is not None
    face = Renderer(mesh, RenderSettings(width=width, height=height, shadows=False)).buffers(view.camera).face
    of_face = mesh.look.vertex_colors[mesh.faces, :3].mean(axis=1).astype(np.float32) / 255
    return of_face[face], face >= 0


def gaussians_near_mesh(cloud: GaussianCloud, mesh: TriangleMesh, *, radius: float) -> Bool[np.ndarray, " G"]:
    """Select Gaussians near the mesh that are neither wide nor faint; `radius` is that of the region."""
    faintest = 0.02
    largest = 0.15  # share of the region's radius; wider Gaussians belong to the background
    distance = cKDTree(mesh.vertices).query(cloud.means, distance_upper_bound=NEAR_SHARE * radius)[0]
    narrow = cloud.scales.max(axis=1) < largest * radius
    chosen: Bool[np.ndarray, " G"] = np.isfinite(distance) & narrow & (cloud.opacity > faintest)
    return chosen
