"""What engines open holds the motion that the spectrum tells: read by pygltflib, pxr and OpenEXR."""

import io
import zipfile

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdValidation
from scipy.spatial.transform import Rotation

from benchmarks._read_exports import read_usdz, read_vertex_texture
from dynamictree.errors import InputError
from dynamictree.formats.motion.usd import write_motion_usdz
from dynamictree.formats.motion.vertex_texture import MAX_SIDE, texture_layout, vertex_texture_files
from dynamictree.formats.stored_zip import write_stored_zip
from dynamictree.mesh import TriangleMesh
from dynamictree.rig.rig import quantise_shares
from dynamictree.rotation import unit_quaternions
from dynamictree.skin import Skin, SkinSummary
from tests.formats.meshes import trunk_and_crown

SUMMARY = SkinSummary(num_joints=3, num_keys=6, relative_error=0.5, rms_error_m=0.25, max_error_m=0.75)


def frames_of(mesh: TriangleMesh, rng: np.random.Generator, num_frames: int = 7) -> np.ndarray:
    return rng.normal(scale=0.1, size=(num_frames, mesh.num_vertices, 3)).astype(np.float32)


def test_a_mesh_without_texture_places_has_its_lookup_in_the_second_set(rng) -> None:
    whole = trunk_and_crown(rng)
    mesh = TriangleMesh(vertices=whole.vertices, faces=whole.faces)
    frames, stream = frames_of(mesh, rng, 3), io.BytesIO()
    write_stored_zip(stream, vertex_texture_files(mesh, iter(frames), num_frames=3, fps=24.0, loop=True))
    np.testing.assert_allclose(read_vertex_texture(stream.getvalue()), frames, atol=2e-3)


@pytest.mark.parametrize("num_vertices", [3, 256, 257, 8_000, 100_000, 600_000])
def test_a_texture_is_no_larger_than_engines_take_and_has_a_texel_for_all(num_vertices: int) -> None:
    layout = texture_layout(num_vertices, 100)
    assert layout.width <= MAX_SIDE
    assert layout.height <= MAX_SIDE
    assert (layout.rows_per_frame - 1) * layout.width < num_vertices <= layout.rows_per_frame * layout.width


def test_what_no_texture_holds_is_refused_with_what_one_would_hold() -> None:
    with pytest.raises(InputError, match=r"663,552 vertices at 100 frames; the mesh has 700,000"):
        texture_layout(700_000, 100)


def problems_of(stage: Usd.Stage) -> list[str]:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    return [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


def test_usd_holds_every_frame_binds_each_face_to_its_material_and_passes_its_validators(tmp_path, rng) -> None:
    mesh = trunk_and_crown(rng)
    frames = frames_of(mesh, rng)
    path = tmp_path / "tree.usdz"
    with path.open("wb") as stream:
        write_motion_usdz(mesh, iter(frames), stream, fps=30.0)
    np.testing.assert_allclose(read_usdz(path), frames, atol=1e-6)
    stage = Usd.Stage.Open(str(path))
    assert problems_of(stage) == []
    assert (stage.GetTimeCodesPerSecond(), UsdGeom.GetStageUpAxis(stage)) == (30.0, "Z")
    assert zipfile.ZipFile(path).namelist() == ["tree.usdc", "texture_1.png"]
    result = np.full(mesh.num_faces, "", object)
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Subset):
            bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
            result[list(UsdGeom.Subset(prim).GetIndicesAttr().Get())] = bound.GetPath().name
    np.testing.assert_array_equal(result, np.array(["bark_0", "leaf_1"])[mesh.look.face_material])


def test_the_validators_would_see_a_broken_stage(tmp_path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "broken.usda"))
    UsdGeom.Mesh.Define(stage, "/Tree")
    assert problems_of(stage)


def random_skin(mesh: TriangleMesh, rng: np.random.Generator, num_frames: int = 5) -> Skin:
    """Three joints in a row that turn far."""
    turns = unit_quaternions(rng.normal(size=(num_frames * 3, 4)).astype(np.float32))
    return Skin(
        parent=np.array([-1, 0, 1], np.int32),
        joint_m=rng.normal(size=(3, 3)).astype(np.float32),
        rows=np.tile(np.array([0, 1, 2, 0], np.int32), (mesh.num_vertices, 1)),
        weights=quantise_shares(np.pad(rng.uniform(size=(mesh.num_vertices, 3)), ((0, 0), (0, 1)))),
        turns=(np.rint(32767 * turns) / 32767).astype(np.float32).reshape(num_frames, 3, 4),
    )


def posed(mesh: TriangleMesh, skin: Skin) -> np.ndarray:
    """Displacement of the vertices over the loop, its first frame once more: [T + 1, N, 3]."""
    turned = Rotation.from_quat(skin.turns.reshape(-1, 4), scalar_first=True).as_matrix().reshape(-1, 3, 3, 3)
    place = np.tile(skin.joint_m.astype(np.float64), (len(turned), 1, 1))
    for joint in (1, 2):
        place[:, joint] = place[:, joint - 1] + turned[:, joint - 1] @ (skin.joint_m[joint] - skin.joint_m[joint - 1])
        turned[:, joint] = turned[:, joint - 1] @ turned[:, joint]
    arm = mesh.vertices[:, None] - skin.joint_m[skin.rows]
    places = np.einsum("tnjab,njb->tnja", turned[:, skin.rows], arm) + place[:, skin.rows]
    moved = (skin.weights[:, :, None] * places).sum(axis=2) - mesh.vertices
    return np.concatenate([moved, moved[:1]])
