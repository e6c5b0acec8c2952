"""The command `dynamictree interact`."""

import json
import zipfile
from functools import partial

import numpy as np
import pytest
from safetensors.numpy import load_file

from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.requests import Reading
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.commands.conftest import assert_refused
from tests.formats.meshes import written


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tree")
    sample = make_sample(6, "sapling")
    (folder / "tree.spectrum.safetensors").write_bytes(written(write_spectrum, voxel_spectrum(sample, 32)[1]))
    (folder / "tree.obj").write_bytes(written(write_obj, sample.mesh))
    return folder


@pytest.fixture
def interact(run, folder):
    return partial(run, "interact", folder / "tree.spectrum.safetensors")


@pytest.mark.parametrize("locality", ["geodesic", "none"])
def test_a_push_writes_coordinates_and_a_moving_mesh(interact, tmp_path, folder, locality):
    answer = interact("-o", tmp_path, "--mesh", folder / "tree.obj", "--format", "modal,motion,ply",
        "--displacement", -0.5, 0, 0, "--up-axis", "+Z", "--held", "--duration", 0.1, "--frames", 12, "--json",
        "--locality", locality,
    )  # fmt: skip
    assert json.loads(answer.stdout)["num_frames"] == 12
    assert {path.name for path in tmp_path.iterdir()} == {"frames-ply.zip", "modal.safetensors", "motion.safetensors"}
    assert load_file(tmp_path / "modal.safetensors")["q"].shape == (1, 12, 16, 2)
    motion = load_file(tmp_path / "motion.safetensors")
    with (folder / "tree.obj").open("rb") as stream:
        np.testing.assert_allclose(
            motion["vertices"], read_mesh(stream, file_type="obj", reading=Reading(up_axis="+Z")).vertices, atol=1e-6
        )
    # in equilibrium at the start, and swings once it is released after 6 frames
    np.testing.assert_allclose(motion["displacement"][5], motion["displacement"][0], atol=1e-5)
    assert np.abs(motion["displacement"][11] - motion["displacement"][0]).max() > 1e-3
    with zipfile.ZipFile(tmp_path / "frames-ply.zip") as archive:
        assert len(archive.namelist()) == 12


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing pushes"),
        (["--impulse", 1, 0, 0, "--format", "glb"], "no format 'glb'"),
        (["--impulse", 1, 0, 0, "--format", "motion"], "--mesh"),
        (["--displacement", 1, 0, 0], "name it with --mesh, or give --force"),
        (["--impulse", 1, 0, 0, "--integrator", "verlet"], "--integrator is 'verlet': it should be 'exact'"),
        (["--impulse", 1, 0, 0, "--integrator", "explicit-euler"], "diverges"),
        (["--impulse", 1, 0, 0, "--point", 99, 0, 0], "outside of the tree"),
        (["--impulse", 1, 0, 0, "--point", 0, 0, 0, "--voxel", 3], "given twice"),
        (["--impulse", 1, 0, 0, "--mesh", "nowhere.obj", "--format", "ply"], "cannot be read"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_nothing(interact, tmp_path, arguments, words):
    assert_refused(interact("-o", tmp_path / "out", *arguments), words, tmp_path / "out")


def test_every_kind_of_push_and_place_is_taken(interact, tmp_path):
    answer = interact("-o", tmp_path, "--impulse", 1, 0, 0, "--force", 0, 5, 0, "--wind", 4, 0, 0,
        "--voxel", 400, "--radius", 1.0, "--frames", 3, "--locality", "none",
    )  # fmt: skip
    assert answer.returncode == 0
    assert "groups: 1" in answer.stdout
