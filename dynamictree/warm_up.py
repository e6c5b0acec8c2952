"""Compile every kernel that a job of a mesh or a splat or a pull calls, with a tree of a few faces.

Run `python -m dynamictree.warm_up` after an installation: numba caches the machine code on disk, so that the first job
of a new process does not wait for compilation.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.gaussian.animate import iter_poses
from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.force import Drag
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import modal_system
from dynamictree.plant.capture import Capture
from dynamictree.render.camera import cameras_of
from dynamictree.requests import ExportParams, Shot
from dynamictree.rig.rig import rig_of

PARAMS = ExportParams(num_frames=2, loop=False, shot=Shot(side_px=64))


def warm_up() -> None:
    """Compile on two cores: numba compiles one kernel at a time in each process."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for compiled in (pool.submit(animate_mesh), pool.submit(animate_splat)):
            compiled.result()


def animate_mesh() -> None:
    """Pull a small mesh; write its default files, and a turbulent motion."""
    mesh = pole()
    spectrum = method.generate(method.voxelize(mesh), num_steps=1)
    tree = InteractiveTree(modal_system(spectrum), rig := rig_of(mesh, spectrum), mesh)
    pull = Drag(at=tree.contact_at_vertex(mesh.vertices, 24), displacement_m=(0.1, 0.0, 0.0))
    answer = respond(tree.system, group_forces([pull], falloff_m=1.0), dt_s=0.1, num_frames=1, tree=tree)
    next(tree.bent(answer, mesh.vertices, rig.vertices))
    with TemporaryDirectory() as folder:
        for params in (PARAMS, ExportParams(wind_mode="turbulent", num_frames=2, formats=("motion",))):
            write_products(mesh, spectrum, params, Path(folder))


def animate_splat() -> None:
    """Write the default files of a splat; its own kernels come first, while the other process compiles shared ones."""
    mesh = pole()
    cloud = splats_of_mesh(mesh, rng=np.random.default_rng(0)).binding.cloud
    cloud = replace(cloud, sh=np.repeat(cloud.sh, 4, axis=1))  # degree 1: colours turn with the leaves
    (pose,), (camera,) = iter_poses(bind(cloud, mesh), [0 * mesh.vertices]), cameras_of(PARAMS.shot, mesh.vertices, 1)
    render_cloud(cloud, camera, width=PARAMS.shot.side_px, height=PARAMS.shot.side_px, pose=pose)
    mesh_of_cloud(cloud)
    spectrum = method.generate(method.voxelize(mesh), num_steps=1)
    params = PARAMS.model_copy(update={"formats": ("splat", "splat-ply", "png")})
    with TemporaryDirectory() as folder:
        write_products(mesh, spectrum, params, Path(folder), capture=Capture(cloud=cloud, mesh=mesh))


def pole() -> TriangleMesh:
    """Return a square pole of 1 m with a leaf at its top."""
    rings = [(x, y, z) for z in np.linspace(0, 1, 6) for x, y in ((0, 0), (0.05, 0), (0.05, 0.05), (0, 0.05))]
    one, other = np.arange(20), np.arange(20) + [1, 1, 1, -3] * 5  # corners, and the next one of each in its ring
    sides = np.stack([one, other, other + 4, one, other + 4, one + 4], axis=1).reshape(-1, 3)
    vertices = np.array([*rings, (0.05, 0, 0.9), (0.25, 0.02, 0.95), (0.2, 0.15, 1.0)], np.float32)
    return TriangleMesh(vertices=vertices, faces=np.array([*sides, (24, 25, 26)], np.int32))


if __name__ == "__main__":
    warm_up()
