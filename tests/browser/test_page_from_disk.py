"""Pages that play from disk in a real Chromium, without a server, where the spectrum has vertices and Gaussians."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Complex64, Float32
from playwright.sync_api import Page

from benchmarks._read_exports import z_up
from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.formats.motion.html import write_splat_html
from dynamictree.gaussian.animate import AnimatedSplat, iter_poses, reduced_splat
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, iter_motion
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.browser.conftest import Open
from tests.clouds import with_two_leaves

FRAMES = (0, 31, 77)
Opened = Callable[[Path], Page]

PLACES = """(time) => {
  const places = [];
  player.renderer.setAnimationLoop(null);
  player.seek(time);
  player.tree.updateMatrixWorld(true);
  player.tree.traverse((part) => {
    if (part.isMesh && !places.length) {
      for (let i = 0; i < part.geometry.attributes.position.count; i++) {
        places.push(part.getVertexPosition(i, part.position.clone()).toArray());
      }
    }
  });
  return places;
}"""

# what Spark has worked out for its own drawing: places as bits of floats in the first texture;
# before its first sorting has ended it may leave out an update
GAUSSIANS = """async (time) => {
  const { renderer, scene, camera, gaussians, splat } = player;
  renderer.setAnimationLoop(null);
  player.seek(time);
  await gaussians.renderer.update({ scene, camera });
  const { target } = gaussians.renderer.current;
  const bits = new Uint32Array(4 * target.width * Math.ceil(splat.G / target.width));
  renderer.setRenderTarget(target, 0);
  const gl = renderer.getContext();
  gl.readBuffer(gl.COLOR_ATTACHMENT0);
  gl.readPixels(0, 0, target.width, bits.length / 4 / target.width, gl.RGBA_INTEGER, gl.UNSIGNED_INT, bits);
  renderer.setRenderTarget(null);
  const values = new Float32Array(bits.buffer);
  return Array.from({ length: splat.G }, (_, g) => [...values.subarray(4 * g, 4 * g + 3)]);
}"""


@dataclass(frozen=True, kw_only=True)
class Swaying:
    """A tree, its motion in voxels, the frames that meshes show of it, and the sum of modes that splats show."""

    mesh: TriangleMesh
    spectrum: SparseVoxelSpectrum
    frames: list[Float32[np.ndarray, "N 3"]]
    coefficients: Complex64[np.ndarray, "N K 3"]


@pytest.fixture(scope="module")
def swaying() -> Swaying:
    sample = make_sample(3, "sapling", wind=Wind(speed_m_s=6.0, direction_deg=160.0, gust=0.42))
    spectrum = voxel_spectrum(sample, 32)[1]
    return Swaying(
        mesh=sample.mesh,
        spectrum=spectrum,
        frames=list(method.move(spectrum, sample.mesh)),
        coefficients=method.devoxelize(spectrum, sample.mesh),
    )


@pytest.fixture
def opened(view: Open) -> Opened:
    """Opens a page from disk, without a network."""

    def _open(path: Path) -> Page:
        page = view(320, 320).page
        page.context.set_offline(True)
        page.goto(path.as_uri())
        page.wait_for_function("window.player")
        return page

    return _open


def test_the_page_plays_the_motion_from_disk(opened: Opened, swaying: Swaying, tmp_path: Path) -> None:
    path = write_products(swaying.mesh, swaying.spectrum, ExportParams(formats=("html",)), tmp_path)["html"]
    page = opened(path)
    for frame in FRAMES:
        moved = z_up(np.array(page.evaluate(PLACES, frame / 24))) - swaying.mesh.vertices
        assert np.abs(moved - swaying.frames[frame]).max() < 1e-4


def test_the_page_plays_a_splat_with_leaves_from_disk(opened: Opened, swaying: Swaying, tmp_path: Path) -> None:
    binding = reduced_splat(splats_of_mesh(swaying.mesh, rng=np.random.default_rng(0)).binding, share=0.1)
    binding, flutter = with_two_leaves(binding, 100)
    splat = AnimatedSplat(binding=binding, coefficients=swaying.coefficients, num_frames=100, fps=24.0, flutter=flutter)
    with (tmp_path / "tree.html").open("wb") as stream:
        write_splat_html(splat, stream, title="a tree")
    page = opened(tmp_path / "tree.html")
    page.wait_for_function("player.gaussians.drawn", timeout=60_000)
    phases = np.array(FRAMES) / 100
    truth = list(iter_poses(binding, iter_motion(swaying.coefficients, phases), flutter.theta(phases, 100)))
    calm = next(iter_poses(binding, iter_motion(swaying.coefficients, phases)))
    assert np.linalg.norm(truth[0].means - calm.means, axis=1).max() > 0.05
    assert np.linalg.norm(truth[1].means - truth[2].means, axis=1).max() > 0.05
    for frame, pose in zip(FRAMES, truth, strict=True):
        places = np.array(page.evaluate(GAUSSIANS, frame / 24))
        assert np.linalg.norm(places - pose.means, axis=1).max() < 1e-3
