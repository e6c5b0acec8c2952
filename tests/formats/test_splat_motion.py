"""A cloud in motion, as PLY files in an archive and as one compact file."""

import gc
import io
import json
import subprocess
import tempfile
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks._gaussian_scene import wavy_sheet
from dynamictree.errors import NumericsError
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.motion.splat_sequence import iter_splat_files
from dynamictree.formats.stored_zip import write_stored_zip
from dynamictree.formats.tensors.animated_splat import write_animated_splat
from dynamictree.gaussian.animate import AnimatedSplat, iter_splat_frames, reduced_splat
from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.deform import Deformer, Pose
from dynamictree.mesh import TriangleMesh
from dynamictree.rig.flutter import Flutter
from dynamictree.source import Source
from dynamictree.spectrum import iter_motion
from tests.clouds import cloud_at, with_two_leaves
from tests.formats.meshes import written
from tests.formats.stored import animated_splat, archive_of

REFERENCE = Path(__file__).parents[2] / "recipes" / "animated_splat.mjs"


@pytest.fixture(scope="module")
def splat() -> AnimatedSplat:
    """A sheet of a capture with −Y up, in centimetres; one corner is far from every Gaussian."""
    rng = np.random.default_rng(8)
    x, y = np.meshgrid(np.linspace(0, 2, 20), np.linspace(0, 2, 20), indexing="ij")
    vertices = np.stack([x, y, 0.2 * np.sin(2 * x)], axis=-1).reshape(-1, 3).astype(np.float32)
    mesh = TriangleMesh(vertices=vertices, faces=wavy_sheet(2 * 19**2).faces[::2])
    count = 500
    quaternions = rng.normal(size=(count, 4))
    cloud = cloud_at(
        vertices[rng.integers(0, 300, count)] + rng.normal(size=(count, 3)) * 0.01,
        turned=quaternions,
        scale=np.exp(rng.normal(size=(count, 3)) - 4),
        opacity=rng.uniform(0.1, 0.9, count),
        sh=rng.normal(size=(count, 16, 3)),
    )
    cloud = replace(cloud, source=Source(up_axis="-Y", scale=0.01))
    coefficients = (rng.normal(size=(2, 400, 3, 3)) * 0.02).astype(np.float32)
    smooth = np.complex64(np.sin(vertices[:, :1, None] * 2) * (coefficients[0, :1] + 1j * coefficients[1, :1]))
    binding, flutter = with_two_leaves(bind(cloud, mesh), 20)
    return AnimatedSplat(binding=binding, coefficients=smooth, num_frames=20, fps=24.0, flutter=flutter)


def posed(splat: AnimatedSplat, phase: float, flutter: Flutter | None) -> Pose:
    frame = next(iter_motion(splat.coefficients, np.array([phase]), splat.num_frames))
    return Deformer(splat.binding).pose(frame, flutter and next(flutter.theta(np.array([phase]), splat.num_frames)))


def frames_of(splat: AnimatedSplat, count: int = 4) -> Iterator[np.ndarray]:
    return iter_motion(splat.coefficients, np.arange(count) / splat.num_frames, splat.num_frames)


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_the_archive_holds_the_frames_where_the_capture_lay(splat: AnimatedSplat, degree: int) -> None:
    binding = reduced_splat(splat.binding, sh_degree=degree)
    np.testing.assert_array_equal(binding.cloud.sh, splat.binding.cloud.sh[:, : (degree + 1) ** 2])
    with archive_of(iter_splat_files(binding, frames_of(splat), first_number=7)) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == [f"frame_{n:04d}.ply" for n in range(7, 11)]
        read = [
            read_cloud(io.BytesIO(archive.read(name)), file_type="ply", up_axis="-Y", unit_m=0.01)
            for name in archive.namelist()
        ]
    for frame, expected in zip(read, iter_splat_frames(binding, frames_of(splat)), strict=True):
        np.testing.assert_allclose(frame.means, expected.means, atol=2e-6)
        np.testing.assert_allclose(frame.scales, expected.scales, rtol=1e-4)
        np.testing.assert_allclose(frame.opacity, expected.opacity, atol=1e-6)
        np.testing.assert_allclose(np.abs((frame.quaternions * expected.quaternions).sum(axis=1)), 1, atol=1e-5)
        np.testing.assert_allclose(frame.sh, expected.sh, atol=2e-4)
    assert np.abs(read[3].means - read[0].means).max() > 1e-3


def test_the_archive_is_streamed(splat: AnimatedSplat) -> None:
    """Memory does not grow with the number of frames. What other threads take meanwhile is in no smaller of two."""

    def peak(count: int) -> int:
        gc.collect()
        tracemalloc.start()
        with tempfile.TemporaryFile() as stream:
            write_stored_zip(stream, iter_splat_files(splat.binding, frames_of(splat, count)))
        taken = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return taken

    few, many = (min(peak(count) for _ in range(2)) for count in (2, 8))
    assert many < 1.3 * few


def test_the_compact_file_plays_the_same_motion(splat: AnimatedSplat) -> None:
    again = animated_splat(written(write_animated_splat, splat))
    assert (again.num_frames, again.fps) == (splat.num_frames, splat.fps)
    assert len(again.binding.vertices) == len(np.unique(again.binding.triangles)) < len(splat.binding.vertices)
    assert again.binding.cloud.source.up_axis == "-Y"
    for phase in (0.0, 0.31, 0.77):
        ours, theirs = (posed(one, phase, splat.flutter) for one in (splat, again))
        np.testing.assert_allclose(theirs.means, ours.means, atol=5e-4)  # float16 of centimetres
        np.testing.assert_allclose(theirs.scales, ours.scales, rtol=1e-2)
    np.testing.assert_allclose(again.binding.cloud.sh, splat.binding.cloud.sh, atol=2e-3)


PLAYER = """import { readFileSync } from "node:fs"; import { AnimatedSplat } from "REFERENCE";
const file = readFileSync(process.argv[1]);
const splat = new AnimatedSplat(file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength));
console.log(JSON.stringify(splat.at(0.31), (_, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value)));"""


def test_the_player_for_other_engines_shows_the_same_pose(splat: AnimatedSplat, tmp_path) -> None:
    path = tmp_path / "tree.animated-splat.safetensors"
    path.write_bytes(written(write_animated_splat, splat))
    again = animated_splat(path.read_bytes())
    code = PLAYER.replace("REFERENCE", REFERENCE.as_uri())
    played = json.loads(subprocess.check_output(["node", "--input-type=module", "-e", code, str(path)], text=True))
    pose = posed(again, 0.31, splat.flutter)
    far = np.linalg.norm(pose.means - posed(again, 0.31, None).means, axis=1)
    assert far[again.binding.leaves.of >= 0].mean() > 1e-2
    assert not far[again.binding.leaves.of < 0].any()
    np.testing.assert_allclose(np.reshape(played["means"], (-1, 3)), pose.means, atol=5e-5)  # weights are halves
    np.testing.assert_allclose(np.reshape(played["scales"], (-1, 3)), pose.scales, rtol=1e-4)
    same = np.abs((np.reshape(played["quaternions"], (-1, 4)) * pose.quaternions).sum(axis=1))
    np.testing.assert_allclose(same, 1, atol=1e-5)


def test_a_motion_that_does_not_fit_is_refused(splat: AnimatedSplat) -> None:
    with pytest.raises(NumericsError, match="largest of coefficients"):
        write_animated_splat(replace(splat, coefficients=splat.coefficients * np.float32(1e7)), io.BytesIO())
