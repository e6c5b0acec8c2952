"""Every product of one spectrum, opened by a tool that is not ours, shows the spectrum's motion."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pygltflib
import pytest
import trimesh
from alembic3d import Abc, AbcGeom
from pxr import Usd, UsdGeom
from safetensors.numpy import load_file

from benchmarks._read_exports import read_morphs, read_skin, read_usd_skin, reported_facts, world_matrices, z_up
from dynamictree import method
from dynamictree.export.moving_tree import Facts
from dynamictree.export.write import write_products
from dynamictree.formats.motion.alembic import write_motion_alembic
from dynamictree.requests import ExportParams
from dynamictree.rig import skin
from dynamictree.rig.pose import poses
from dynamictree.rig.rig import rig_of
from dynamictree.rig.skin import skin_of
from dynamictree.spectrum import Wind
from tests.export.conftest import FPS, NUM_FRAMES, Products, Sapling
from tests.formats.test_engine_files import problems_of
from tests.js_tools import validated


@pytest.fixture(scope="module")
def truth(sapling: Sapling) -> np.ndarray:
    return np.stack(list(method.move(sapling[1], sapling[0], flutter=0.0)))


def errors_m(played: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Root mean square and largest distance."""
    gap = ((played[: len(truth)] - truth) ** 2).sum(axis=2)
    return float(np.sqrt(gap.mean())), float(np.sqrt(gap.max()))


@pytest.mark.parametrize(("name", "play"), [("glb", read_skin), ("glb-morph", read_morphs)])
def test_what_is_not_exact_says_how_far_off_it_is(
    name: str, play, products: Products, sapling, truth: np.ndarray
) -> None:
    content, facts = products[0][name].read_bytes(), products[1][name]
    rms, most = errors_m(play(content), truth)
    assert facts["rms_error_m"] == pytest.approx(rms, rel=1e-3)
    assert facts["max_error_m"] == pytest.approx(most, rel=1e-3)
    assert facts["relative_error"] == pytest.approx(rms / np.sqrt((truth**2).sum(axis=2).mean()), rel=1e-3)
    assert reported_facts(content) == facts
    assert 0 < facts["relative_error"] < 0.35
    assert sum(len(part.faces) for part in trimesh.load(products[0][name]).geometry.values()) == sapling[0].num_faces


def test_leaves_flutter_frame_by_frame_and_morph_targets_say_that_theirs_do_not(sapling: Sapling, tmp_path) -> None:
    mesh, spectrum = sapling[0], replace(sapling[1], wind=Wind(speed_m_s=8.0), fps=12.0, num_frames=50)
    facts: dict[str, Facts] = {}
    options = ExportParams(formats=("motion", "glb-morph"), fps=12.0, flutter=1.0)
    paths = write_products(mesh, spectrum, options, tmp_path, on_facts=facts.__setitem__)
    played = load_file(paths["motion"])["displacement"]
    without, fluttering = (np.stack(list(method.move(spectrum, mesh, flutter=size))) for size in (0.0, 1.0))
    np.testing.assert_allclose(played, fluttering, atol=1e-5)
    apart = float(np.sqrt(((played - without) ** 2).sum(axis=2).max()))
    assert apart > 1e-3
    assert facts["glb-morph"]["max_error_m"] == pytest.approx(apart, rel=0.05)


def test_usd_core_skins_the_mesh_as_the_fitted_joints_do(
    products: Products, sapling: Sapling, truth: np.ndarray
) -> None:
    path = products[0]["usd-skinned"]
    played, facts = read_usd_skin(path), products[1]["usd-skinned"]
    assert facts == products[1]["glb"]
    assert set(products[1]) == {"glb", "glb-morph", "usd-skinned", "lod", "rig"}, "what is exact has nothing to tell"
    rms, most = errors_m(played, truth)
    assert facts["rms_error_m"] == pytest.approx(rms, rel=1e-3)
    assert facts["max_error_m"] == pytest.approx(most, rel=1e-3)
    np.testing.assert_allclose(played[-1], played[0], atol=1e-7)
    np.testing.assert_allclose(played, read_skin(products[0]["glb"].read_bytes()), atol=1e-5)
    stage = Usd.Stage.Open(str(path))
    assert problems_of(stage) == []
    assert (UsdGeom.GetStageUpAxis(stage), stage.GetTimeCodesPerSecond()) == (UsdGeom.Tokens.z, FPS)


def test_alembic_has_material_sets_and_seams(products: Products, sapling: Sapling) -> None:
    mesh, path = sapling[0], products[0]["alembic"]
    schema = AbcGeom.IPolyMesh(Abc.IArchive(str(path)).getTop(), "tree").getSchema()
    assert schema.getTimeSampling().getSampleTime(1) == pytest.approx(1 / FPS)
    corners = np.array(memoryview(schema.getValue().getFaceIndices())).reshape(-1, 3)
    np.testing.assert_array_equal(corners[:, ::-1], mesh.faces)
    assert list(schema.getFaceSetNames()) == [material.name for material in mesh.look.materials]
    for number, material in enumerate(mesh.look.materials):
        faces = schema.getFaceSet(material.name).getSchema().getValue().getFaces()
        np.testing.assert_array_equal(np.array(memoryview(faces)), np.flatnonzero(mesh.look.face_material == number))
    uv = np.random.default_rng(0).random((mesh.num_vertices, 2)).astype(np.float32)
    with path.with_name("seams.abc").open("wb") as stream:
        write_motion_alembic(
            replace(mesh, look=replace(mesh.look, uv=uv)), [np.zeros_like(mesh.vertices)], stream, fps=24.0
        )
    schema = AbcGeom.IPolyMesh(Abc.IArchive(stream.name).getTop(), "tree").getSchema()
    read = schema.getUVsParam().getExpandedValue(Abc.ISampleSelector(0)).getVals()
    np.testing.assert_allclose(
        np.array(memoryview(read)), uv[mesh.faces[:, ::-1].ravel()] * [1, -1] + [0, 1], atol=1e-7
    )


def test_more_joints_are_nearer_to_the_rig_and_all_are_the_rig(sapling: Sapling, products, monkeypatch) -> None:
    mesh, rig, sizes = sapling[0], rig_of(*sapling), list[int]()
    errors = [skin_of(rig, mesh.vertices, count)[1].relative_error for count in (8, 32, 128, len(rig.skeleton))]
    assert errors[0] > errors[1] > 1.3 * errors[2] > 0
    assert errors[3] < 0.1 * errors[2]  # keys have 16 bits
    assert products[1]["glb"]["num_joints"] <= 64
    monkeypatch.setattr(skin, "poses", lambda bones, theta: sizes.append(theta[..., 0].size) or poses(bones, theta))
    turns = skin_of(replace(rig, num_frames=1_000_000 // len(rig.skeleton)), mesh.vertices, 9999)[0].turns
    assert max(sizes) <= 500_000 < sum(sizes)  # poses of 43,000 cards over 100 frames took 1.1 GB
    assert (turns[1:] * turns[:-1]).sum(axis=2).min() > 0.99  # no sign changes between two parts of the loop


def test_a_skin_of_all_bones_is_exact_to_its_keys_and_small(sapling: Sapling, truth: np.ndarray, tmp_path) -> None:
    """Keys in 16 bits are off by 0.03 mrad, which no child adds to: 2e-5 of the height, with floats 4e-6."""
    path = write_products(*sapling, ExportParams(formats=("glb",), flutter=0.0), tmp_path)["glb"]
    assert errors_m(read_skin(path.read_bytes()), truth)[1] < 2e-5 * sapling[0].height_m
    rest = len(trimesh.Trimesh(sapling[0].vertices, sapling[0].faces, process=False).export(file_type="glb"))
    assert path.stat().st_size < 1.3 * rest + 1e6


def test_a_rig_has_wind_groups_for_its_joints(products: Products, truth: np.ndarray) -> None:
    archive = zipfile.ZipFile(products[0]["rig"])
    content = archive.read("tree-rig.glb")
    rms, _ = errors_m(read_skin(content), truth)
    assert products[1]["rig"]["rms_error_m"] == pytest.approx(rms, rel=1e-3)
    document = pygltflib.GLTF2().load_from_bytes(content)
    wind = json.loads(archive.read("dynamic-wind.json"))
    assert [joint["JointName"] for joint in wind["Joints"]] == [
        document.nodes[n].name for n in document.skins[0].joints
    ]
    groups = wind["SimulationGroups"]
    assert {joint["SimulationGroupIndex"] for joint in wind["Joints"]} == set(range(len(groups)))
    assert [group["bIsTrunkGroup"] for group in groups] == [True] + [False] * (len(groups) - 1)
    assert all(0 <= g["MinInfluence"] <= g["Influence"] <= g["MaxInfluence"] <= 1 for g in groups)
    assert groups[0]["Influence"] < groups[1]["Influence"]  # a trunk bends less than what it bears


def test_capsules_lie_in_the_wood_and_follow_it(products: Products, sapling: Sapling, truth: np.ndarray) -> None:
    archive, mesh = zipfile.ZipFile(products[0]["rig"]), sapling[0]
    wood = np.unique(mesh.faces[mesh.look.face_material == 0])
    rig = pygltflib.GLTF2().load_from_bytes(archive.read("tree-rig.glb"))
    world, inside = world_matrices(rig), np.zeros(len(wood), bool)
    numbers = {node.name: number for number, node in enumerate(rig.nodes)}
    gaps, sways = list[np.ndarray](), list[np.ndarray]()
    for capsule in json.loads(archive.read("collision.json"))["capsules"]:
        start, end = z_up(np.array([capsule["start_m"], capsule["end_m"]]))
        axis = end - start
        along = np.clip((mesh.vertices[wood] - start) @ axis / max(axis @ axis, 1e-9), 0, 1)
        near = np.linalg.norm(mesh.vertices[wood] - start - along[:, None] * axis, axis=1) < 1.2 * capsule["radius_m"]
        inside |= near
        if near.any():
            sways.append(truth[:, wood[near]].mean(axis=1))
            placed = world[numbers[capsule["joint"]]][:NUM_FRAMES]
            middle = (np.array(capsule["start_m"]) + capsule["end_m"]) / 2
            arm = middle - rest_place(rig, numbers[capsule["joint"]])
            gaps.append(z_up(placed[:, :3, :3] @ arm + placed[:, :3, 3] - middle) - sways[-1])
    assert len(sways) > 20
    assert inside.mean() > 0.6
    assert np.sqrt((np.array(gaps) ** 2).mean() / (np.array(sways) ** 2).mean()) < 0.5


def rest_place(document: pygltflib.GLTF2, node: int) -> np.ndarray:
    """Of a joint, which no other above it turns at rest."""
    above = {child: number for number, entry in enumerate(document.nodes) for child in entry.children or []}
    own = np.array(document.nodes[node].translation or (0, 0, 0))
    return own + rest_place(document, above[node]) if node in above else own


@pytest.mark.slow
def test_khronos_validator_finds_nothing_wrong(products: Products, tmp_path) -> None:
    zipfile.ZipFile(products[0]["vat"]).extract("tree-rest.glb", tmp_path)
    files = [products[0][name] for name in ("glb", "glb-morph")] + [tmp_path / "tree-rest.glb"]
    assert [(report["numErrors"], report["numWarnings"]) for report in validated(files)] == [(0, 0)] * 3
