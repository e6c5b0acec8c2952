import zipfile

import numpy as np
import pygltflib
import pytest

from dynamictree.spectrum import FPS, NUM_FRAMES, to_motion
from lab.dataset.export import EXPORTS, export_sample


@pytest.mark.parametrize("name", sorted(EXPORTS))
def test_an_export_appears_whole_under_its_own_name(sapling, tmp_path, name):
    path = export_sample(sapling, name, tmp_path)
    assert [path] == list(tmp_path.iterdir())
    assert path.name == f"4dtree-{sapling.seed:07d}{EXPORTS[name][0]}"


def test_the_glb_holds_the_trees_vertices(sapling, tmp_path):
    document = pygltflib.GLTF2().load(str(export_sample(sapling, "glb", tmp_path)))
    primitives = [primitive for mesh in document.meshes for primitive in mesh.primitives]
    assert sum(document.accessors[one.attributes.POSITION].count for one in primitives) >= sapling.mesh.num_vertices
    assert all(one.targets for one in primitives)


def test_the_ply_sequence_has_a_file_a_frame(sapling, tmp_path):
    with zipfile.ZipFile(export_sample(sapling, "ply", tmp_path)) as archive:
        assert len(archive.namelist()) == NUM_FRAMES
        assert archive.testzip() is None


def test_usd_plays_the_motion(sapling, tmp_path):
    usd = pytest.importorskip("pxr.Usd")
    geometry = pytest.importorskip("pxr.UsdGeom")
    stage = usd.Stage.Open(str(export_sample(sapling, "usd", tmp_path)))
    assert geometry.GetStageUpAxis(stage) == geometry.Tokens.z
    assert geometry.GetStageMetersPerUnit(stage) == 1
    assert stage.GetTimeCodesPerSecond() == FPS
    mesh = geometry.Mesh(stage.GetPrimAtPath("/Tree/Surface"))
    assert mesh.GetPointsAttr().GetNumTimeSamples() == NUM_FRAMES
    motion = to_motion(sapling.coefficients)
    for frame in (0, 41):
        points = np.array(mesh.GetPointsAttr().Get(frame))
        np.testing.assert_allclose(points, sapling.mesh.vertices + motion[frame], atol=1e-5)
