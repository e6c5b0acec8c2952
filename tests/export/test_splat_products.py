"""A cloud that moves with a mesh, written as every product."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom, UsdVol

from dynamictree import method
from dynamictree.commands.input_files import load_capture
from dynamictree.errors import FormatError, InputError
from dynamictree.export.pictures import SplatScene
from dynamictree.export.size import min_sequence_bytes
from dynamictree.export.write import Recall, write_products
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.splat import write_splat
from dynamictree.formats.tensors.bundle import read_cloud_bundle, write_bundle
from dynamictree.gaussian.animate import iter_poses
from dynamictree.gaussian.binding import bind
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import Capture, carrying_mesh, moving_part
from dynamictree.requests import CloudParams, ExportParams, Format, Shot
from dynamictree.source import Source
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.up_axis import up_rotation
from dynamictree.voxel.voxelize import voxelize
from tests.clouds import cloud_at, with_two_leaves
from tests.formats.meshes import written
from tests.formats.stored import animated_splat

Moving = tuple[TriangleMesh, SparseVoxelSpectrum]
BOX = ((-0.3, -0.3, -0.1), (0.3, 0.3, 1.1))
SMALL = Shot(side_px=128)


@pytest.fixture(scope="module")
def capture() -> Capture:
    """A post of 1 m, and a pot beside it."""
    rng = np.random.default_rng(2)
    angle, height = rng.random(3000) * 2 * np.pi, rng.random(3000)
    post = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), height], axis=1)
    post[2000:] = post[2000:] * [1, 1, 0.2] + [1, 0, 0]
    cloud = cloud_at(post, sh=rng.normal(size=(3000, 1, 3)))
    return Capture(cloud=replace(cloud, source=Source(up_axis="-Y")))


@pytest.fixture(scope="module")
def moving(capture: Capture) -> Moving:
    """The surface of the post, with which it moves, and its motion.

    It bends along +X as the square of the height, four frames a loop, sections as a rod's; no fibre breaks (0.5 %).
    """
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("dynamictree.gaussian.cloud_mesh.MAX_FACES", 4000)  # a post needs no more
        mesh = carrying_mesh(capture, CloudParams(box_m=BOX))
    grid = voxelize(mesh, 32).grid
    coefficients = np.zeros((len(grid), 2, 3), np.complex64)
    x, _, z = grid.centres_m.T
    coefficients[:, 1, 0] = 0.0125 * z**2
    coefficients[:, 1, 2] = -0.025 * z * x
    return mesh, SparseVoxelSpectrum(grid=grid, coefficients=coefficients, fps=24.0, num_frames=4, model="test")


Write = Callable[[Capture, ExportParams, list[float]], dict[str, Path]]


@pytest.fixture
def animated(moving: Moving, recall: Recall, tmp_path_factory) -> Write:
    """Writes what a capture shows of the motion."""

    def write(capture: Capture, options: ExportParams, done: list[float]) -> dict[str, Path]:
        folder, choice = tmp_path_factory.mktemp("products"), CloudParams(box_m=BOX)
        return write_products(*moving, options, folder, done.append, capture=capture, choice=choice, recall=recall)

    return write


def beside_the_post(capture: Capture) -> Capture:
    """The pot is nearer, and in the picture."""
    beside = np.where(np.arange(3000) < 2000, 0, -0.7).astype(np.float32)
    cloud = replace(capture.cloud, means=capture.cloud.means + beside[:, None] * np.float32([1, 0, 0]))
    return replace(capture, cloud=cloud, mask=beside == 0)


def test_all_products_show_one_motion(capture: Capture, animated: Write) -> None:
    done: list[float] = []
    options = ExportParams(formats=("splat-ply", "splat", "png", "glb"), shot=SMALL)
    capture = beside_the_post(capture)
    paths = animated(capture, options, done)
    assert done == sorted(done)
    assert done[-1] == 1
    with zipfile.ZipFile(paths["splat-ply"]) as archive:
        frames = [read_cloud(io.BytesIO(archive.read(name)), file_type="ply") for name in archive.namelist()]
    assert len(frames) == 4
    cloud, tree = capture.cloud, moving_part(capture, CloudParams(box_m=BOX))
    np.testing.assert_array_equal(tree, np.arange(3000) < 2000)
    for frame in frames:
        np.testing.assert_allclose(frame.means[~tree], cloud.means[~tree], atol=1e-6)  # the pot stays
    moved = frames[0].means[tree] - cloud.means[tree]
    expected = 0.025 * cloud.means[tree, 2] ** 2  # w c cos 0, w = 2
    assert np.abs(moved[:, 0] - expected).max() < 0.00375
    stated = min_sequence_bytes(("splat-ply",), 4, options, cloud=(3000, 0))["splat-ply"]
    assert 1 < paths["splat-ply"].stat().st_size / stated < 1.02
    assert animated_splat(paths["splat"].read_bytes()).binding.cloud.num_gaussians == 3000
    with Image.open(paths["png"]) as picture:
        pixels = np.asarray(picture).astype(int)
    row = pixels[-232:].reshape(232, 8, 160, 3)
    assert np.abs(row[:, 0] - row[:, 4]).max() > 50  # left, then right
    assert pixels.shape == (1084, 1280, 3)
    assert (pixels[:26, :400].min(axis=2) < 120).any()  # a title
    sway = pixels[26:826, 800:].reshape(-1, 3)
    yellow, blue = (sway @ [1, 0, -1] > 100), (sway @ [-1, 0, 1] > 30) & (sway[:, 0] < 90)
    grey = np.ptp(sway, axis=1) < 12
    grey &= np.abs(sway.mean(axis=1) - 149) < 12  # the pot beside the post
    assert min(yellow.sum(), blue.sum(), grey.sum()) > 300, (yellow.sum(), blue.sum(), grey.sum())


def test_a_part_of_the_motion_and_of_the_cloud_is_asked_for(capture: Capture, animated: Write) -> None:
    options = ExportParams(
        formats=("splat-ply",), first_frame=2, num_frames=1, loop=False, share=0.1, sh_degree=0, shot=SMALL
    )
    paths = animated(capture, options, [])
    with zipfile.ZipFile(paths["splat-ply"]) as archive:
        assert archive.namelist() == ["frame_0002.ply"]
        frame = read_cloud(io.BytesIO(archive.read("frame_0002.ply")), file_type="ply")
    assert frame.num_gaussians == 300
    top = frame.means[(frame.means[:, 2] > 0.9) & (frame.means[:, 0] < 0.5)]
    assert top[:, 0].mean() < -0.0125  # half a loop on: to the left
    stated = min_sequence_bytes(("splat-ply",), 1, options, cloud=(3000, 0))["splat-ply"]
    assert 1 < paths["splat-ply"].stat().st_size / stated < 1.1


def test_films_show_what_stands_still_in_grey(capture: Capture, moving: Moving, animated: Write) -> None:
    """The pot beside the post has the colours of the file only if asked for."""
    near = beside_the_post(capture)
    colours = {}
    for grey in (True, False):
        scene = SplatScene.of(bind(near.cloud, moving[0], mask=moving_part(near)), ground=False, grey_still=grey)
        still = ~scene.binding.moving
        assert still.sum() == 1000
        assert (scene.binding.cloud.sh[~still] == capture.cloud.sh[~still]).all()
        assert (np.ptp(scene.binding.cloud.sh[still, 0], axis=1).max() < 1e-5) == grey
        shot = SMALL.model_copy(update={"ground": False, "grey_still": grey})
        paths = animated(near, ExportParams(formats=("webp",), shot=shot), [])
        with Image.open(paths["webp"]) as film:
            colours[grey] = np.ptp(np.asarray(film.convert("RGB")).astype(int), axis=2)
    assert (colours[True] < 12).sum() > (colours[False] < 12).sum() + 300


def test_a_mesh_becomes_a_splat_that_moves(moving: Moving, recall: Recall, tmp_path) -> None:
    paths = write_products(*moving, ExportParams(formats=("splat", "webp"), shot=SMALL), tmp_path, recall=recall)
    splat = animated_splat(paths["splat"].read_bytes())
    assert splat.binding.cloud.num_gaussians >= 5 * moving[0].num_faces * 0.9
    assert splat.binding.moving.all()


@pytest.fixture
def files(capture: Capture, moving: Moving, tmp_path) -> dict[str, Path]:
    """The capture, its mesh in the same axes, and a mask, as someone sends them."""
    files_by_role = {"cloud": tmp_path / "tree.SPLAT", "mesh": tmp_path / "mesh.ply", "mask": tmp_path / "mask.npy"}
    turned = moving[0].with_vertices(np.ascontiguousarray(moving[0].vertices @ up_rotation("-Y").astype(np.float32)))
    files_by_role["cloud"].write_bytes(written(write_splat, capture.cloud))
    files_by_role["mesh"].write_bytes(written(write_ply, turned))
    np.save(files_by_role["mask"], np.arange(3000) < 2000)
    return files_by_role


def test_a_capture_is_read_with_what_came_with_it(capture: Capture, moving: Moving, files: dict[str, Path]) -> None:
    read = load_capture(files["cloud"], mask=files["mask"], mesh=files["mesh"])
    scale = read.cloud.source.scale  # the file states no unit: 5 m high
    assert scale > 1
    np.testing.assert_allclose(read.cloud.means, capture.cloud.means * scale, atol=1e-5)
    np.testing.assert_allclose(read.mesh.vertices, moving[0].vertices * scale, atol=1e-4)
    assert carrying_mesh(read) is read.mesh
    np.testing.assert_array_equal(moving_part(read), moving_part(capture, CloudParams(box_m=BOX)))
    again = read_cloud_bundle(io.BytesIO(written(write_bundle, read)))
    for name in ("means", "quaternions", "scales", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(again.cloud, name), getattr(read.cloud, name))
    np.testing.assert_array_equal(again.mask, read.mask)
    np.testing.assert_array_equal(again.mesh.vertices, read.mesh.vertices)


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (b"no mask", "no .npy file"),
        (np.zeros(3000, np.bool_), "lets no Gaussian move"),
        (np.ones(2999, np.bool_), "2,999 values for 3,000"),
        (np.full(3000, 2, np.uint8), "0 or 1"),
        (np.ones((3000, 1), np.bool_), "one row"),
        (np.ones(5_005_000, np.uint8), "a byte a Gaussian"),
    ],
)
def test_a_bad_mask_is_refused(files: dict[str, Path], mask: bytes | np.ndarray, message: str) -> None:
    if isinstance(mask, bytes):
        files["mask"].write_bytes(mask)
    else:
        np.save(files["mask"], mask)
    with pytest.raises(InputError, match=message):
        load_capture(files["cloud"], mask=files["mask"])


def test_what_does_not_fit_together_is_refused(capture: Capture, files: dict[str, Path]) -> None:
    with pytest.raises(FormatError, match="send one cloud"):
        load_capture(files["cloud"], mesh=files["cloud"])
    pot = replace(capture, mask=np.arange(3000) >= 2000)
    with pytest.raises(InputError, match="no Gaussian moves that is of the mask and of the box"):
        moving_part(pot, CloudParams(box_m=BOX))


@pytest.mark.parametrize(
    ("name", "limit", "message"),
    [
        ("splat-ply", "export.size.MAX_SEQUENCE_BYTES", "ask for fewer frames"),
        ("usd-splat", "export.size.MAX_SEQUENCE_BYTES", "Gaussians .* as usd-splat .* fewer frames, a lower"),
        ("html-splat", "formats.motion.html.MAX_SPLAT_BYTES", "3,000 Gaussians as html-splat .* ask for a lower share"),
    ],
)
def test_too_large_a_splat_is_refused_before_a_byte_is_written(
    capture: Capture, moving: Moving, recall: Recall, tmp_path, monkeypatch, name: Format, limit: str, message: str
) -> None:
    monkeypatch.setattr(f"dynamictree.{limit}", 1000)
    with pytest.raises(InputError, match=message):
        write_products(*moving, ExportParams(formats=(name,)), tmp_path, capture=capture, recall=recall)
    assert [path for path in tmp_path.iterdir() if path.stat().st_size] == []


def test_usd_and_ply_have_every_pose_and_leaf(capture, moving: Moving, animated: Write, monkeypatch) -> None:
    params = ExportParams(formats=("usd-splat", "splat-ply"), num_frames=4)
    path = animated(capture, params, [])["usd-splat"]
    stated = min_sequence_bytes(("usd-splat",), 4, params, cloud=(3000, 0))["usd-splat"]
    assert 1 < path.stat().st_size / stated < 1.3
    half = ExportParams(formats=("usd-splat",), share=0.5)
    assert min_sequence_bytes(("usd-splat",), 4, half, cloud=(3000, 0)) == {"usd-splat": stated // 2}
    monkeypatch.setattr("dynamictree.export.write.flutter_leaves", lambda binding, *_: with_two_leaves(binding, 4))
    paths = animated(capture, params, [])
    stage = Usd.Stage.Open(str(paths["usd-splat"]))
    splat = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Tree/Splat"))
    assert splat.GetPositionsAttr().GetTimeSamples() == [0, 1, 2, 3]
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    binding = bind(capture.cloud, moving[0], mask=moving_part(capture, CloudParams(box_m=BOX)))
    binding, flutter = with_two_leaves(binding, 4)
    turns = list(flutter.theta(np.arange(4) / 4, 4))
    assert np.abs(turns[0] - turns[2]).max() > 0.05
    poses = list(iter_poses(binding, method.move(moving[1], moving[0], num_frames=4), turns))
    assert np.abs(poses[0].means - poses[2].means).max() > 0.025
    with zipfile.ZipFile(paths["splat-ply"]) as archive:
        frames = [read_cloud(io.BytesIO(archive.read(name)), file_type="ply") for name in archive.namelist()]
    for frame, pose in zip(frames, poses, strict=True):
        np.testing.assert_allclose(frame.means, pose.means, atol=1e-5)
    for code, pose in enumerate(poses):
        np.testing.assert_allclose(np.array(splat.GetPositionsAttr().Get(code)), pose.means, atol=1e-6)
        np.testing.assert_allclose(np.array(splat.GetScaleshAttr().Get(code)), pose.scales, rtol=1e-3)
        for row, turned in list(enumerate(splat.GetOrientationshAttr().Get(code)))[::500]:
            wxyz = np.array([turned.GetReal(), *turned.GetImaginary()])
            np.testing.assert_allclose(wxyz, pose.quaternions[row], atol=1e-3)
    np.testing.assert_allclose(np.array(splat.GetOpacitiesAttr().Get()), 0.9)
    harmonics = np.array(splat.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    np.testing.assert_allclose(harmonics, capture.cloud.sh[:, 0])
