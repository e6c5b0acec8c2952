"""Compile every kernel that a job of a mesh or a splat calls, with a tree of a few faces.

Run `python -m dynamictree.warm_up` after an installation: numba caches the machine code on disk, so that the first job
of a new process does not wait for compilation.
"""

from concurrent.futures import ProcessPoolExecutor
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
from dynamictree.modal.pull import grip_of, pull_to
from dynamictree.plant.capture import Capture
from dynamictree.render.camera import cameras_of
from dynamictree.requests import ExportParams, Shot

PARAMS = ExportParams(num_frames=2, loop=False, shot=Shot(side_px=64))
TURBULENT = ExportParams(wind_mode="turbulent", num_frames=2, formats=("motion",))


def warm_up() -> None:
    """Compile on two cores: numba compiles one kernel at a time in each process."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for compiled in (pool.submit(animate_mesh), pool.submit(animate_splat)):
            compiled.result()


def animate_mesh() -> None:
    """Write the default files of a small mesh, and a turbulent motion; compile the solver of pulls first."""
    pull_to(grip_of(np.eye(3), np.ones(3)), np.array([0.1, 0.0, 0.0]))
    mesh = pole()
    spectrum = method.generate(method.voxelize(mesh), num_steps=1)
    with TemporaryDirectory() as folder:
        for params in (PARAMS, TURBULENT):
            write_products(mesh, spectrum, params, Path(folder))


def animate_splat() -> None:
    """Write the default files of a splat; its own kernels come first, while the other process compiles shared ones."""
    mesh = pole()
    cloud = splats_of_mesh(mesh, rng=np.random.default_rng(0)).binding.cloud
    binding = bind(cloud, mesh)
    (pose,) = iter_poses(binding, [np.zeros_like(mesh.vertices)])
    (camera,) = cameras_of(PARAMS.shot, mesh.vertices, 1)
    render_cloud(cloud, camera, width=PARAMS.shot.side_px, height=PARAMS.shot.side_px, pose=pose)
    mesh_of_cloud(cloud)
    spectrum = method.generate(method.voxelize(mesh), num_steps=1)
    with TemporaryDirectory() as folder:
        write_products(mesh, spectrum, PARAMS, Path(folder), capture=Capture(cloud=cloud, mesh=mesh))


def pole() -> TriangleMesh:
    """Return a square pole of 1 m with a leaf at its top."""
    ring = np.array([[0, 0], [0.05, 0], [0.05, 0.05], [0, 0.05]])
    rings = [np.column_stack([ring, np.full(4, height)]) for height in np.linspace(0, 1, 6)]
    leaf = np.array([[0.05, 0, 0.9], [0.25, 0.02, 0.95], [0.2, 0.15, 1.0]])
    sides = [
        (4 * level + corner, 4 * level + (corner + 1) % 4, 4 * level + 4 + corner, 4 * level + 4 + (corner + 1) % 4)
        for level in range(5)
        for corner in range(4)
    ]
    faces = [face for a, b, c, d in sides for face in ((a, b, d), (a, d, c))]
    return TriangleMesh(
        vertices=np.concatenate([*rings, leaf]).astype(np.float32),
        faces=np.array([*faces, (24, 25, 26)], np.int32),
    )


if __name__ == "__main__":
    warm_up()
