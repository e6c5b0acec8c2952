"""Clouds that pass through tools that are not ours: trimesh, and PlayCanvas' splat-transform (`make js-tools`)."""

import subprocess
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.source_file import source_kind
from dynamictree.formats.splat.ply import property_names, write_gaussian_ply
from dynamictree.formats.splat.sog import write_sog
from dynamictree.formats.splat.splat import write_splat
from dynamictree.formats.splat.spz import write_spz
from dynamictree.gaussian.cloud import GaussianCloud
from tests.formats.ksplat_bytes import ksplat_bytes
from tests.formats.meshes import written
from tests.formats.test_cloud_round_trips import covariances, make_cloud

TOOL = Path(__file__).parents[2] / ".cache" / "js-tools" / "node_modules" / ".bin" / "splat-transform"


def vertices_by_trimesh(stream: BytesIO) -> np.ndarray:
    """The rows of a PLY file, with all of their properties."""
    return trimesh.load(stream, file_type="ply").metadata["_ply_raw"]["vertex"]["data"]


def ply_of(rows: np.ndarray, *, text: bool, order: str) -> bytes:
    """The rows as PLY in an encoding that we do not write."""
    encoding = "ascii" if text else {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = ["ply", f"format {encoding} 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {name}" for name in rows.dtype.names]
    if text:
        body = "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in rows).encode()
    else:
        body = rows.astype([(name, f"{order}f4") for name in rows.dtype.names]).tobytes()
    return ("\n".join([*head, "end_header"]) + "\n").encode() + body


def test_trimesh_reads_what_we_write(rng) -> None:
    cloud = make_cloud(rng, degree=2)
    stream = BytesIO()
    write_gaussian_ply(cloud, stream)
    stream.seek(0)
    vertex = vertices_by_trimesh(stream)
    assert list(vertex.dtype.names) == property_names(9)
    assert len(vertex) == cloud.num_gaussians
    np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), cloud.opacity, rtol=1e-5)
    np.testing.assert_allclose(np.exp(vertex["scale_1"]), cloud.scales[:, 1], rtol=1e-5)
    np.testing.assert_allclose(vertex["f_rest_0"].std(), vertex["f_rest_23"].std(), rtol=0.5)


@pytest.mark.parametrize(("text", "order"), [(True, "<"), (False, "<"), (False, ">")])
def test_a_ply_of_any_encoding_is_read_by_its_names(rng, text: bool, order: str) -> None:
    cloud = make_cloud(rng, degree=1)
    stream = BytesIO()
    write_gaussian_ply(cloud, stream)
    stream.seek(0)
    rows = vertices_by_trimesh(stream)
    shuffled = np.empty(len(rows), [(name, "f4") for name in rng.permutation(list(rows.dtype.names))])
    for name in shuffled.dtype.names:
        shuffled[name] = rows[name]
    read = read_cloud(BytesIO(ply_of(shuffled, text=text, order=order)), file_type="ply")
    for name in ("means", "scales", "opacity", "sh"):
        np.testing.assert_allclose(getattr(read, name), getattr(cloud, name), rtol=2e-5, atol=2e-6)


@pytest.fixture(scope="module")
def transform() -> Path:
    if not TOOL.exists():
        pytest.skip("splat-transform is not there: make js-tools, with node and npm")
    return TOOL


def through(tool: Path, source: Path, target: Path) -> GaussianCloud:
    """What splat-transform makes of a file, read by us."""
    subprocess.run([tool, "--overwrite", "-g", "cpu", source, target], check=True, capture_output=True, timeout=120)
    with target.open("rb") as stream:
        kind, file_type = source_kind(stream, target.name)
        assert kind == "cloud"
        return read_cloud(stream, file_type=file_type, up_axis="-Y" if file_type == "spz" else None)


def sorted_like(read: GaussianCloud, cloud: GaussianCloud) -> GaussianCloud:
    """In the order of the other: the tool sorts some formats."""
    away = ((read.means[None] - cloud.means[:, None]) ** 2).sum(axis=2)
    return read.subset(np.argmin(away, axis=1))


def assert_alike(read: GaussianCloud, cloud: GaussianCloud, tolerance: float) -> None:
    assert read.num_gaussians == cloud.num_gaussians
    read = sorted_like(read, cloud)
    np.testing.assert_allclose(read.means, cloud.means, atol=tolerance)
    np.testing.assert_allclose(read.opacity, cloud.opacity, atol=tolerance + 1e-6)
    scale = np.abs(covariances(cloud)).max(axis=(1, 2))
    np.testing.assert_array_less(
        np.abs(covariances(read) - covariances(cloud)).max(axis=(1, 2)) / scale, 10 * tolerance + 1e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize(("ending", "tolerance"), [("ply", 1e-5), ("compressed.ply", 0.02)])
def test_splat_transform_reads_our_ply(transform: Path, tmp_path, rng, ending: str, tolerance: float) -> None:
    cloud = make_cloud(rng, degree=3)
    (tmp_path / "ours.ply").write_bytes(written(write_gaussian_ply, cloud))
    assert_alike(through(transform, tmp_path / "ours.ply", tmp_path / f"theirs.{ending}"), cloud, tolerance)


@pytest.mark.slow
def test_splat_transform_reads_our_splat_and_spz(transform: Path, tmp_path, rng) -> None:
    cloud = make_cloud(rng, degree=0)
    (tmp_path / "ours.splat").write_bytes(written(write_splat, cloud))
    assert_alike(through(transform, tmp_path / "ours.splat", tmp_path / "of-splat.ply"), cloud, 0.02)
    (tmp_path / "ours.spz").write_bytes(written(write_spz, cloud))
    through(transform, tmp_path / "ours.spz", tmp_path / "theirs.spz")
    with (tmp_path / "ours.spz").open("rb") as ours, (tmp_path / "theirs.spz").open("rb") as theirs:
        assert_alike(read_cloud(theirs, file_type="spz"), read_cloud(ours, file_type="spz"), 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1])
def test_splat_transform_and_we_read_each_others_sog(transform: Path, tmp_path, rng, degree: int) -> None:
    cloud = make_cloud(rng, degree=degree)
    (tmp_path / "ours.sog").write_bytes(written(write_sog, cloud))
    of_ours = through(transform, tmp_path / "ours.sog", tmp_path / "of-ours.ply")
    assert_alike(of_ours, cloud, 0.02)
    np.testing.assert_allclose(sorted_like(of_ours, cloud).sh, cloud.sh, atol=0.03)
    (tmp_path / "ours.ply").write_bytes(written(write_gaussian_ply, cloud))
    theirs = through(transform, tmp_path / "ours.ply", tmp_path / "theirs.sog")
    assert_alike(theirs, cloud, 0.03)
    np.testing.assert_allclose(sorted_like(theirs, cloud).sh[:, 0], cloud.sh[:, 0], atol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("level", [0, 1, 2])
def test_splat_transform_and_we_read_the_same_ksplat(transform: Path, tmp_path, rng, level: int) -> None:
    cloud = make_cloud(rng, degree=2)
    cloud = replace(cloud, means=np.clip(cloud.means, -2.4, 2.4))
    (tmp_path / "a.ksplat").write_bytes(ksplat_bytes(cloud, level))
    theirs = through(transform, tmp_path / "a.ksplat", tmp_path / "theirs.ply")
    with (tmp_path / "a.ksplat").open("rb") as stream:
        ours = read_cloud(stream, file_type="ksplat")
    for name in ("means", "scales", "opacity", "sh"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(covariances(ours), covariances(theirs), rtol=1e-3, atol=1e-6)
