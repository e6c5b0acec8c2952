"""Draw the moving picture of the README: a tree in wind, and the same tree when a branch is pulled and released.

Both halves repeat without a jump: the wind motion is a loop, and the pull is repeated until its response is periodic.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image, ImageDraw

from dynamictree import method
from dynamictree.devoxelize.smooth import smooth
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.bone_attachment import attach_mesh
from dynamictree.modal.force import Drag, contact_at_voxel, generalised_force
from dynamictree.modal.interactive_tree import Answer, InteractiveTree
from dynamictree.modal.locality import branching, poke_weights
from dynamictree.modal.response import group_forces
from dynamictree.modal.step import State, exact_step, run
from dynamictree.modal.system import ModalSystem, modal_system
from dynamictree.render import Camera, Look, Renderer
from dynamictree.requests import PAPER_PERIOD_S
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, iter_motion
from lab.dataset.sample import make_sample

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "moving.webp"
SPECIES, SEED = "round-broadleaf", 7
WIND = Wind(speed_m_s=9.0, gust=0.4)
WIDTH_PX, HEIGHT_PX = 380, 460
AZIMUTH_DEG = 25.0
LOOPS, FRAMES_PER_LOOP = 2, 50  # two wind loops of 4.17 s at 12 fps
PULL_S, RELEASE_S = 2.2, 2.7  # the pull grows until the first, then is constant until the second
PULL_SHARE = 0.17  # of the height
CANDIDATE_STEP = 25  # every so many voxels is a place to pull at
FALLOFF_SHARE = 0.25  # of the height
DAMPING_RATIO = 0.13  # measured on broadleaf trees in leaf
MAX_BYTES = 3_000_000


def main() -> None:
    mesh = make_sample(SEED, SPECIES).mesh
    spectrum = method.generate(method.voxelize(mesh), seed=SEED, wind=WIND, period_s=PAPER_PERIOD_S)
    system = modal_system(spectrum, damping_ratio=DAMPING_RATIO)
    camera = camera_of(mesh)
    voxel, displacement_m = branch_pull(system, camera.world_to_camera[0])
    renderer = Renderer(mesh, Look(width=WIDTH_PX, height=HEIGHT_PX))
    swaying = wind_frames(mesh, spectrum)
    frame_s = spectrum.period_s / FRAMES_PER_LOOP
    pulled = pull_frames(mesh, system, voxel, displacement_m, frame_s=frame_s)
    tip = int(np.argmin(np.linalg.norm(mesh.vertices - system.grid.centres_m[voxel], axis=1)))
    pictures = []
    for number, (sway, pull) in enumerate(zip(swaying, pulled, strict=True)):
        left, right = (renderer.picture(moved, camera=camera) for moved in (sway, pull))
        marker = (
            camera.project((mesh.vertices[tip] + pull[tip])[None], WIDTH_PX, HEIGHT_PX)[0]
            if number * frame_s < RELEASE_S
            else None
        )
        pictures.append(beside(left, right, marker))
    save(pictures, 1000 * frame_s)
    print(f"{PICTURE}: {PICTURE.stat().st_size / 1e6:.2f} MB")


def camera_of(mesh: TriangleMesh) -> Camera:
    """Room on both sides for the sway, and above the tree for a line of text."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = (low + high) / 2
    roomy = middle + (mesh.vertices - middle) * (1.15, 1.15, 1.0)
    top = np.array([[middle[0], middle[1], high[2] + 0.06 * (high[2] - low[2])]])
    return Camera.orbit(np.concatenate([roomy, top]), azimuth_deg=AZIMUTH_DEG, aspect=WIDTH_PX / HEIGHT_PX)


def branch_pull(system: ModalSystem, right: Float64[np.ndarray, "3"]) -> tuple[int, tuple[float, float, float]]:
    """The branch on the right that carries most, and a pull downwards and out [m]."""
    centres = system.grid.centres_m
    height = float(np.ptp(centres[:, 2]))
    trunk = centres[np.argmin(centres[:, 2])]
    away = (centres - trunk) @ right > 0.12 * height
    candidates = np.flatnonzero(away & (centres[:, 2] > trunk[2] + 0.4 * height))[::CANDIDATE_STEP]
    tree = branching(system)
    carried = [float(poke_weights(tree, int(row), 0.01 * height).sum()) for row in candidates]
    x, y, z = PULL_SHARE * height * (0.5 * right + (0.0, 0.0, -0.8))
    return int(candidates[np.argmax(carried)]), (x, y, z)


def wind_frames(mesh: TriangleMesh, spectrum: SparseVoxelSpectrum) -> Iterator[Float32[np.ndarray, "N 3"]]:
    phases = np.arange(LOOPS * FRAMES_PER_LOOP) / FRAMES_PER_LOOP
    return iter_motion(method.devoxelize(spectrum, mesh), phases, spectrum.num_frames)


def pull_frames(
    mesh: TriangleMesh, system: ModalSystem, voxel: int, displacement_m: tuple[float, float, float], *, frame_s: float
) -> Iterator[Float32[np.ndarray, "N 3"]]:
    """Periodic response to a pull that is repeated once per picture."""
    num_frames, finer = LOOPS * FRAMES_PER_LOOP, 8  # steps per frame
    num_steps = num_frames * finer
    drag = Drag(at=contact_at_voxel(system.grid, voxel), displacement_m=displacement_m)
    times = np.arange(num_steps) * frame_s / finer
    share = np.clip(times / PULL_S, 0, 1)
    strength = share**2 * (3 - 2 * share) * (times < RELEASE_S)
    force = generalised_force(system, drag, dt_s=frame_s / finer, num_frames=num_steps)
    pushed = (strength[:, None] * force)[:, None] / system.modal_mass  # [T, 1, M]
    step, state = exact_step(system, frame_s / finer), State.at_rest(1, system.num_modes)
    for _ in range(6):  # until what is left of the first pulls is below a thousandth
        q, state = run(step, state, pushed)
    groups = group_forces([drag], falloff_m=FALLOFF_SHARE * float(np.ptp(mesh.vertices[:, 2])))
    tree = InteractiveTree(system)
    ties = smooth(system.grid, mesh)
    carried = attach_mesh(tree.bones, mesh, ties, voxel_size_m=system.grid.voxel_size_m)
    yield from tree.bent(Answer(groups=groups, q=q[::finer], final=state), mesh.vertices, carried)


def beside(
    left: UInt8[np.ndarray, "H W 3"], right: UInt8[np.ndarray, "H W 3"], marker: Float64[np.ndarray, "3"] | None
) -> Image.Image:
    picture = Image.fromarray(np.concatenate([left, right], axis=1))
    draw = ImageDraw.Draw(picture)
    draw.line((WIDTH_PX, 0, WIDTH_PX, HEIGHT_PX), fill=(255, 255, 255), width=3)
    for x, text in ((10, "wind, 9 m/s"), (WIDTH_PX + 10, "a branch pulled and released")):
        draw.text((x, 8), text, fill=(60, 60, 60), font_size=15)
    if marker is not None:
        x, y = WIDTH_PX + marker[0], marker[1]
        draw.ellipse((x - 6, y - 6, x + 6, y + 6), outline=(220, 40, 30), width=3)
    return picture


def save(pictures: list[Image.Image], frame_ms: float) -> None:
    """At the highest quality that fits."""
    for quality in (80, 70, 60, 50, 40, 30):
        pictures[0].save(
            PICTURE,
            save_all=True,
            append_images=pictures[1:],
            duration=round(frame_ms),
            loop=0,
            quality=quality,
            method=4,
        )
        if PICTURE.stat().st_size <= MAX_BYTES:
            return
    raise SystemExit(f"{PICTURE} has {PICTURE.stat().st_size} bytes; at most {MAX_BYTES} are allowed: lower WIDTH_PX")


if __name__ == "__main__":
    main()
