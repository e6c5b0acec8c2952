"""The method on one page: from the shape of a tree to its motion. Paper figure 2, left to right.

    mesh ──voxelize──▶ voxels ──generate──▶ spectrum ──rig──▶ bones that turn ──move──▶ moving mesh
                                                                                   │
    splat ──bind──▶ each Gaussian on its nearest face ──────────────────────────deform─┴──▶ moving splat

A mesh is a `TriangleMesh` or an object of trimesh: in metres, with +Z up. Lengths are metres, times are seconds.
Importing this module loads no torch; `generate` does.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.devoxelize.nearest import nearest_rows
from dynamictree.gaussian.animate import NO_FLUTTER, iter_splat_frames
from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.leaves import flutter_leaves
from dynamictree.mesh import AnyMesh, TriangleMesh, triangle_mesh
from dynamictree.plant.trees.of_mesh import stand_resolution
from dynamictree.requests import GridParams, Resolution, Wind
from dynamictree.rig.flutter import fluttering
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion
from dynamictree.voxel.voxelize import SurfaceVoxels
from dynamictree.voxel.voxelize import voxelize as voxelize_surface

Devoxelization = Literal["rig", "paper"]
"""How voxels move vertices: by bones that turn, or by the nearest voxel's displacement."""


def animate(
    mesh: AnyMesh,
    *,
    wind: Wind | None = None,
    seed: int = 0,
    model: str = "small",
    num_frames: int | None = None,
    flutter: float = 1.0,
    devoxelization: Devoxelization = "rig",
) -> Iterator[Float32[np.ndarray, "N 3"]]:
    """Yield the positions of the mesh's vertices, frame by frame over one loop of the generated motion [m]."""
    mesh = triangle_mesh(mesh)
    spectrum = generate(voxelize(mesh), wind=wind, seed=seed, model=model)
    for displacement in move(spectrum, mesh, num_frames=num_frames, flutter=flutter, devoxelization=devoxelization):
        yield mesh.vertices + displacement


def animate_splat(
    cloud: GaussianCloud,
    mesh: AnyMesh,
    spectrum: SparseVoxelSpectrum,
    *,
    num_frames: int | None = None,
    flutter: float = 1.0,
) -> Iterator[GaussianCloud]:
    """Yield frames of a splat that moves with its mesh: the paper's output; for the options see `move`."""
    mesh = triangle_mesh(mesh)
    rig = rig_of(mesh, spectrum)
    binding, leaves = flutter_leaves(bind(cloud, mesh), rig, spectrum, flutter)
    phases = np.linspace(0, 1, num_frames or spectrum.num_frames, endpoint=False)
    turns = leaves.theta(phases, spectrum.num_frames) if leaves else NO_FLUTTER
    moved = _moved(fluttering(rig, spectrum, flutter), mesh, phases)
    yield from iter_splat_frames(binding, moved, turns)


def voxelize(mesh: AnyMesh, *, resolution: Resolution = 128, source_sha256: str = "") -> SurfaceVoxels:
    """Find the voxels that the surface occupies, with their normals. Paper section 3.3.

    Voxels, and spectra generated from them, record `source_sha256`, the hash of the mesh's file, and how it was read.
    """
    mesh = triangle_mesh(mesh)
    finest = stand_resolution(mesh, GridParams(resolution=resolution).resolution)
    return voxelize_surface(mesh, finest, source=replace(mesh.source, sha256=source_sha256))


def generate(
    voxels: SurfaceVoxels,
    *,
    wind: Wind | None = None,
    seed: int = 0,
    model: str = "small",
    num_steps: int | None = None,
    period_s: float | None = None,
    wind_bands: bool = False,
    foliage: float | None = None,
    of_cloud: bool = False,
    on_step: Callable[[int, int], None] | None = None,
) -> SparseVoxelSpectrum:
    """Generate the spectrum of a motion of these voxels. Paper section 3.4.

    By default the pace follows the tree's height: periods of 4.17 s up to 7 m and 16.7 s from 22 m, and trees below 8 m
    are faster than the simulator's (a paper's model: 4.17 s, and no faster).
    With `wind_bands` the model also runs for five other winds, to find the strength of each mode there.
    `foliage` is 0 for a bare tree and 1 for one in leaf; by default it is estimated from the shape, except for surfaces
    made from a cloud (`of_cloud`).
    `on_step` receives the number of completed sampler steps and their total.
    """
    from dynamictree.models import loaded_once
    from dynamictree.models.gust_travel import delay_downwind
    from dynamictree.models.periods import PERIOD_S, period_by_height, with_period
    from dynamictree.models.several_trees import generate_trees, with_bands

    trained = loaded_once(model)
    if period_s is None:
        period_s = period_by_height(voxels) if trained.paced_by_height else PERIOD_S

    def in_wind(blowing: Wind, report: Callable[[int, int], None] | None) -> SparseVoxelSpectrum:
        of_one = partial(trained.generate, wind=blowing, num_steps=num_steps)
        paced = with_period(of_one, period_s, quick_when_small=trained.paced_by_height)

        def of_tree(
            voxels: SurfaceVoxels, *, seed: int, on_step: Callable[[int, int], None] | None = None
        ) -> SparseVoxelSpectrum:
            drawn = paced(voxels, seed=seed, on_step=on_step)
            return delay_downwind(drawn, blowing) if trained.adds_gust_travel else drawn

        return generate_trees(of_tree, voxels, seed=seed, on_step=report)

    own = wind or Wind()
    spectrum = with_bands(in_wind, own, on_step) if wind_bands else in_wind(own, on_step)
    stated = foliage if foliage is not None or of_cloud else spectrum.foliage
    return replace(spectrum, source=voxels.source, foliage=stated)


def devoxelize(
    spectrum: SparseVoxelSpectrum, mesh: AnyMesh, how: Devoxelization = "rig"
) -> Complex64[np.ndarray, "N K 3"]:
    """Give each vertex its spectrum [m]: Dev(·) of paper eq. 1.

    With "rig" it is the spectrum of the bones' loop; `rig_of(mesh, spectrum)` gives its frames without stretch. With
    "paper" it is that of the nearest voxel, literally eq. 1, which tears neighbours apart.
    """
    mesh = triangle_mesh(mesh)
    if how == "rig":
        rig = rig_of(mesh, spectrum)
        return rig.loop(mesh.vertices, rig.vertices)
    moved: Complex64[np.ndarray, "N K 3"] = spectrum.coefficients[nearest_rows(spectrum.grid, mesh.vertices)]
    moved[mesh.still_vertices] = 0
    return moved


def move(
    spectrum: SparseVoxelSpectrum,
    mesh: AnyMesh,
    *,
    num_frames: int | None = None,
    flutter: float = 1.0,
    devoxelization: Devoxelization = "rig",
) -> Iterator[Float32[np.ndarray, "N 3"]]:
    """Yield the displacement of each vertex, frame by frame over one loop [m], the same as in every written file.

    `num_frames` are spread over the loop; by default there is one every 1/24 s. `flutter` is how far leaves turn above
    the spectrum's frequencies: 0 not at all, 1 as in nature. With "paper" the nearest voxels' displacements are added.
    """
    mesh = triangle_mesh(mesh)
    num_frames = spectrum.num_frames if num_frames is None else num_frames
    phases = np.arange(num_frames) / num_frames
    if devoxelization == "paper":
        yield from iter_motion(devoxelize(spectrum, mesh, "paper"), phases, spectrum.num_frames)
        return
    yield from _moved(fluttering(rig_of(mesh, spectrum), spectrum, flutter), mesh, phases)


def _moved(rig: Rig, mesh: TriangleMesh, phases: Float64[np.ndarray, " M"]) -> Iterator[Float32[np.ndarray, "N 3"]]:
    return (rig.displacement(theta, mesh.vertices, rig.vertices) for theta in rig.theta(phases))
