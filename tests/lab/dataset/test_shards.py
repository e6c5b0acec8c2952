import hashlib
import json
import subprocess
import sys
import time
from dataclasses import asdict, replace

import numpy as np
import psutil
import pytest
import safetensors.numpy

from dynamictree.errors import FormatError, InputError
from lab.dataset.generate import Recipe, bake_shard, generate, is_baked, manifest_of, shard_name
from lab.dataset.limits import DatasetLimits
from lab.dataset.sample import make_sample, voxel_spectrum
from lab.dataset.shards import iter_shard, stored_tree, write_shard
from tests.formats.meshes import written

TINY = Recipe(trees=3, trees_per_shard=2, resolutions=(32,), first_seed=40, species="sapling")


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A tiny dataset, baked in this process."""
    folder = tmp_path_factory.mktemp("4dtree")
    for index in range(TINY.num_shards):
        bake_shard(TINY, index, folder)
    return folder


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_an_unknown_species_or_seed_is_refused():
    with pytest.raises(InputError, match="no species 'oak'"):
        make_sample(0, "oak")
    with pytest.raises(InputError, match="seed is -1"):
        make_sample(-1)


def test_a_voxel_has_the_motion_of_the_surface_inside(sapling):
    voxels, spectrum = voxel_spectrum(sapling, 64)
    assert spectrum.grid is voxels.grid
    low = voxels.grid.centres_m[:, 2] < 0.01 * sapling.mesh.height_m
    still, moving = (np.abs(spectrum.coefficients[rows]).max() for rows in (low, ~low))
    assert still < 0.01 * moving
    assert moving <= np.abs(sapling.coefficients).max() * 1.001


def test_reading_undoes_writing(sapling, tmp_path):
    stored = stored_tree(sapling, resolutions=(32, 64))
    path = tmp_path / "one.safetensors"
    path.write_bytes(written(write_shard, [stored]))
    (tree,) = iter_shard(str(path))
    assert (tree.seed, tree.species, tree.wind, tree.split) == (7, "sapling", sapling.wind, "train")
    np.testing.assert_array_equal(tree.tensors["vertices"], sapling.mesh.vertices)
    np.testing.assert_array_equal(tree.tensors["faces"], sapling.mesh.faces)
    for name, value in asdict(sapling.skeleton).items():
        np.testing.assert_array_equal(getattr(tree.skeleton(), name), value)
    for resolution in (32, 64):
        voxels, spectrum = voxel_spectrum(sapling, resolution)
        np.testing.assert_array_equal(tree.voxels(resolution).grid.coords, voxels.grid.coords)
        assert tree.voxels(resolution).grid.origin_m == voxels.grid.origin_m
        np.testing.assert_allclose(tree.voxels(resolution).normals, voxels.normals, atol=1e-3)
        scale = np.abs(spectrum.coefficients).max()
        np.testing.assert_allclose(tree.spectrum(resolution).coefficients, spectrum.coefficients, atol=1e-3 * scale)


def test_what_is_no_shard_is_refused(tmp_path):
    path = tmp_path / "no.safetensors"
    path.write_bytes(b"not at all")
    with pytest.raises(FormatError, match="no safetensors file"):
        list(iter_shard(str(path)))
    path.write_bytes(safetensors.numpy.save({"a": np.zeros(1)}, metadata={"4dtree": '{"version": 99}'}))
    with pytest.raises(FormatError, match="version 99"):
        list(iter_shard(str(path)))


def test_the_bytes_do_not_depend_on_the_number_of_workers(baked, tmp_path):
    generate(TINY, tmp_path / "two", workers=2)
    contents_of_two = contents(tmp_path / "two")
    for name, content in contents(baked).items():
        assert contents_of_two[name] == content, name


def test_a_run_goes_on_where_it_was_cut_off(baked, tmp_path):
    folder = tmp_path / "again"
    folder.mkdir()
    for name, content in contents(baked).items():
        if name.startswith(shard_name(0)):
            (folder / name).write_bytes(content)
    (folder / f"{shard_name(1)}.safetensors").write_bytes(b"half a shard")
    stored = (folder / f"{shard_name(0)}.safetensors").stat().st_mtime_ns
    reports = []
    manifest = generate(TINY, folder, on_shard=lambda done, total: reports.append((done, total)))
    assert reports == [(2, 3), (3, 3)]
    assert manifest["complete"]
    assert (folder / f"{shard_name(0)}.safetensors").stat().st_mtime_ns == stored
    for name, content in contents(baked).items():
        assert (folder / name).read_bytes() == content


def test_parts_share_the_work(baked, tmp_path):
    assert not generate(TINY, tmp_path, part=(1, 2))["complete"]
    assert not (tmp_path / f"{shard_name(0)}.safetensors").exists()
    assert (tmp_path / f"{shard_name(1)}.safetensors").read_bytes() == contents(baked)[f"{shard_name(1)}.safetensors"]
    for ending in (".safetensors", ".json"):
        name = f"{shard_name(0)}{ending}"
        (tmp_path / name).write_bytes((baked / name).read_bytes())
    assert generate(TINY, tmp_path, part=(1, 2))["complete"]
    with pytest.raises(InputError, match="part is 2/2"):
        generate(TINY, tmp_path, part=(2, 2))


def test_the_manifest_tells_what_is_there(baked):
    manifest = manifest_of(TINY, baked)
    assert manifest["complete"]
    assert manifest["trees"] == 3
    for shard in manifest["shards"]:
        assert hashlib.sha256((baked / shard["file"]).read_bytes()).hexdigest() == shard["sha256"]
        assert len(list(iter_shard(str(baked / shard["file"])))) == shard["trees"]
    assert sum(manifest["species"].values()) == sum(manifest["splits"].values()) == 3


def test_another_recipe_is_baked_anew(baked):
    assert is_baked(TINY, 0, baked)
    assert not is_baked(replace(TINY, resolutions=(64,)), 0, baked)
    assert not is_baked(replace(TINY, review={40: "reject"}), 0, baked)
    assert is_baked(replace(TINY, review={4000: "reject"}), 0, baked)  # a verdict on a tree of another shard


def test_an_accepted_tree_is_stored_whatever_the_filter_says(tmp_path):
    impossible = DatasetLimits(self_explosion=0.0)
    bake_shard(replace(TINY, trees=1, limits=impossible, review={43: "accept"}), 0, tmp_path)
    record = json.loads((tmp_path / f"{shard_name(0)}.json").read_bytes())
    assert [tree["seed"] for tree in record["trees"]] == [43]
    assert set(record["rejected"]) == {"40", "41", "42"}


def test_limits_that_let_nothing_through_are_reported(tmp_path):
    recipe = replace(TINY, trees=1, trees_per_shard=1, limits=DatasetLimits(self_explosion=0.0))
    with pytest.raises(InputError, match="only 0 of 4 trees"):
        bake_shard(recipe, 0, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_workers_end_with_a_killed_parent(tmp_path):
    arguments = ["dataset", "generate", str(tmp_path), "--trees", "400", "--workers", "2"]
    program = [sys.executable, "-m", "dynamictree.cli", *arguments]
    parent = subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        workers = []
        until = time.monotonic() + 60
        while len(workers) < 2 and time.monotonic() < until:
            time.sleep(0.1)
            children = psutil.Process(parent.pid).children()
            workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
        assert len(workers) == 2
    finally:
        parent.kill()
        parent.wait()
    gone, alive = psutil.wait_procs(workers, timeout=60)
    assert not alive
    assert len(gone) == 2
