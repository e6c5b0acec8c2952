"""Laws of the cloud formats: what is written is read again, as exactly as the format can hold it."""

import io
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import BinaryIO

import numpy as np
import pytest

from dynamictree.formats.cloud_file import cloud_kind, read_cloud
from dynamictree.formats.gltf.gaussian import write_gltf_gaussian
from dynamictree.formats.splat.codebook import palette_of
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.formats.splat.sog import write_sog
from dynamictree.formats.splat.splat import write_splat
from dynamictree.formats.splat.spz import write_spz
from dynamictree.gaussian.axes import to_source_axes, to_z_up
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0, harmonics
from dynamictree.rotation import quaternion_matrices
from tests.clouds import cloud_at
from tests.formats.ksplat_bytes import ksplat_bytes

Write = Callable[[GaussianCloud, BinaryIO], None]


def make_cloud(
    rng: np.random.Generator, count: int = 300, *, degree: int = 1, up_axis: str = "-Y", unit_m: float = 1.0
) -> GaussianCloud:
    quaternions = rng.normal(size=(count, 4))
    cloud = cloud_at(
        rng.normal(size=(count, 3)),
        turned=quaternions,
        scale=np.exp(rng.normal(size=(count, 3)) - 3),
        opacity=rng.uniform(0.01, 0.99, count),
        sh=rng.uniform(-0.9, 0.9, size=(count, (degree + 1) ** 2, 3)),
    )
    return replace(cloud, source=replace(cloud.source, up_axis=up_axis, scale=unit_m))


def covariances(cloud: GaussianCloud) -> np.ndarray:
    rotations = quaternion_matrices(cloud.quaternions.astype(np.float64))
    return rotations * cloud.scales[:, None, :] ** 2 @ rotations.transpose(0, 2, 1)


def read_back(cloud: GaussianCloud, write: Write, file_type: str) -> GaussianCloud:
    stream = io.BytesIO()
    write(cloud, stream)
    assert cloud_kind(stream, file_type=file_type) == "gaussians"
    up_axis = cloud.source.up_axis if file_type in ("ply", "splat") else None
    return read_cloud(stream, file_type=file_type, up_axis=up_axis, unit_m=cloud.source.scale)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize(("write", "file_type"), [(write_gaussian_ply, "ply"), (write_gltf_gaussian, "glb")])
def test_ply_and_glb_keep_every_value(rng, degree: int, write: Write, file_type: str) -> None:
    cloud = make_cloud(rng, degree=degree, unit_m=0.01)
    again = read_back(cloud, write, file_type)
    for name in ("means", "scales", "opacity", "sh"):
        np.testing.assert_allclose(getattr(again, name), getattr(cloud, name), rtol=2e-5, atol=2e-6)
    np.testing.assert_allclose(covariances(again), covariances(cloud), rtol=1e-4, atol=1e-7)


def test_splat_keeps_positions_and_scales_and_rounds_the_rest(rng) -> None:
    cloud = make_cloud(rng, degree=2)
    again = read_back(cloud, write_splat, "splat")
    np.testing.assert_allclose(again.means, cloud.means, atol=1e-6)
    np.testing.assert_allclose(again.scales, cloud.scales, rtol=1e-6)
    np.testing.assert_allclose(again.opacity, cloud.opacity, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(again.sh[:, 0], cloud.sh[:, 0], atol=0.5 / 255 / 0.282 + 1e-6)
    cosine = np.abs((again.quaternions * cloud.quaternions).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 1.5
    assert again.sh_degree == 0


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_stays_within_its_rounding(rng, degree: int) -> None:
    cloud = make_cloud(rng, degree=degree)
    again = read_back(cloud, write_spz, "spz")
    up = replace(again, source=replace(again.source, up_axis="-Y"))
    np.testing.assert_allclose(up.means, cloud.means, atol=0.5 / 4096 + 1e-6)
    np.testing.assert_allclose(np.log(up.scales), np.log(cloud.scales), atol=1 / 32 + 1e-5)
    np.testing.assert_allclose(up.opacity, cloud.opacity, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(up.sh[:, 0], cloud.sh[:, 0], atol=0.5 / 255 / 0.15 + 1e-6)
    rest = up.sh[:, 1:] - cloud.sh[:, 1:]
    assert degree == 0 or np.sqrt((rest**2).mean()) < 0.125 / np.sqrt(12) * 1.2  # a bucket of 4 bits, evenly filled
    assert np.abs((covariances(up) - covariances(cloud)) / cloud.scales.max(axis=1)[:, None, None] ** 2).max() < 0.08


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_sog_stays_within_its_rounding(rng, degree: int) -> None:
    cloud = make_cloud(rng, degree=degree, up_axis="+Z", unit_m=0.1)
    again = read_back(cloud, write_sog, "sog")
    assert again.num_gaussians == 300
    assert again.sh_degree == degree
    walked_m = [np.linalg.norm(np.diff(one.means, axis=0), axis=1).sum() for one in (again, cloud)]
    assert walked_m[0] < 0.6 * walked_m[1]  # neighbours follow one another, which the pictures' size depends on
    order = ((again.means[None] - cloud.means[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    again = again.subset(order)
    np.testing.assert_allclose(again.means, cloud.means, atol=4e-4)
    cosine = np.abs((again.quaternions * cloud.quaternions).sum(axis=1))
    assert np.sqrt((np.arccos(np.minimum(cosine, 1)) ** 2).mean()) < 0.0045
    np.testing.assert_allclose(np.log(again.scales), np.log(cloud.scales), atol=0.1)
    np.testing.assert_allclose(again.opacity, cloud.opacity, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(again.sh, cloud.sh, atol=0.03)
    assert np.abs((covariances(again) - covariances(cloud)) / cloud.scales.max(axis=1)[:, None, None] ** 2).max() < 0.06
    assert np.sqrt(((np.log(again.scales) - np.log(cloud.scales)) ** 2).mean()) < 0.006


def test_sog_of_few_values_keeps_them(rng) -> None:
    cloud = make_cloud(rng, degree=0)
    scales = np.exp(np.linspace(-6, -1, 200)).astype(np.float32)[rng.integers(0, 200, (300, 3))]
    few = replace(
        cloud, scales=scales, means=np.zeros((300, 3), np.float32), opacity=np.arange(300, dtype=np.float32) / 299
    )
    again = read_back(few, write_sog, "sog")
    assert not again.means.any()
    np.testing.assert_allclose(np.sort(again.scales, axis=0), np.sort(scales, axis=0), rtol=1e-5)
    np.testing.assert_allclose(
        again.sh[again.opacity == 0], few.sh[:1], atol=0.03
    )  # what is not visible has its colour


def test_a_palette_has_a_near_row_for_every_row(rng) -> None:
    middles = rng.normal(size=(32, 9))
    of = rng.integers(0, 32, 5000)
    rows = (middles[of] + 0.01 * rng.normal(size=(5000, 9))).astype(np.float32)
    palette, labels = palette_of(rows, 1024)
    assert len(palette) == 1024
    assert np.bincount(labels).max() <= 5
    assert np.sqrt(((palette[labels] - rows) ** 2).mean()) < 0.1 * rows.std()
    exact, every = palette_of(rows[:1000], 1024)
    np.testing.assert_array_equal(exact[every], rows[:1000])


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_ksplat_is_read_within_its_rounding(rng, level: int, degree: int) -> None:
    cloud = make_cloud(rng, degree=degree)
    cloud = replace(cloud, means=np.clip(cloud.means, -2.4, 2.4))
    again = read_cloud(io.BytesIO(ksplat_bytes(cloud, level)), file_type="ksplat", up_axis="+Z")
    np.testing.assert_allclose(again.means, cloud.means, atol=1e-6 if level == 0 else 1e-4)
    np.testing.assert_allclose(again.scales, cloud.scales, rtol=1e-6 if level == 0 else 1e-3)
    np.testing.assert_allclose(again.opacity, cloud.opacity, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(again.sh[:, 0], cloud.sh[:, 0], atol=0.5 / 255 / 0.282 + 1e-6)
    np.testing.assert_allclose(again.sh[:, 1:], cloud.sh[:, 1:], atol=(1e-6, 1e-3, 0.5 / 127)[level])
    np.testing.assert_allclose(covariances(again), covariances(cloud), rtol=0.02, atol=1e-3 * cloud.scales.max() ** 2)


def test_ksplat_without_steps_or_range_has_those_of_its_viewer(rng) -> None:
    cloud = make_cloud(rng, degree=1)
    cloud = replace(cloud, means=np.clip(cloud.means, -2.4, 2.4))
    content = bytearray(ksplat_bytes(cloud, 2))
    stated = read_cloud(io.BytesIO(content), file_type="ksplat", up_axis="+Z")
    struct.pack_into("<ff", content, 36, 0, 0)  # the range of harmonics: -1.5 to 1.5 in place of -1 to 1
    for section in (0, 1):
        struct.pack_into("<H", content, 4096 + 1024 * section + 24, 0)  # the steps of places: 32,767
    again = read_cloud(io.BytesIO(content), file_type="ksplat", up_axis="+Z")
    np.testing.assert_allclose(again.sh[:, 1:], 1.5 * stated.sh[:, 1:], atol=1e-6)
    np.testing.assert_array_equal(again.means, stated.means)


def test_spz_holds_clouds_that_reach_far(rng) -> None:
    cloud = make_cloud(rng, degree=0)
    far = replace(cloud, means=cloud.means * 20_000)
    np.testing.assert_allclose(read_back(far, write_spz, "spz").means, far.means, atol=0.01)


@pytest.mark.parametrize("up_axis", ["+X", "-X", "+Y", "-Y", "+Z", "-Z"])
def test_axes_and_units_are_undone_and_colours_turn_with_them(rng, up_axis: str) -> None:
    source = make_cloud(rng, degree=3, up_axis="+Z")
    cloud = to_z_up(source, up_axis=up_axis, unit_m=0.1)
    again = to_source_axes(cloud)
    np.testing.assert_allclose(again.means, source.means, atol=1e-6)
    np.testing.assert_allclose(again.sh, source.sh, atol=1e-5)
    np.testing.assert_allclose(covariances(again), covariances(source), atol=1e-6)
    up = np.zeros(3)
    up["XYZ".index(up_axis[1])] = 1 if up_axis[0] == "+" else -1
    seen_from_above = harmonics(np.array([[0.0, 0.0, 1.0]]), 3) @ cloud.sh
    np.testing.assert_allclose(seen_from_above, harmonics(up[None], 3) @ source.sh, atol=1e-5)
    assert int(np.argmax(cloud.means[:, 2])) == int(np.argmax(source.means @ up))


@pytest.mark.parametrize(
    ("name", "count", "degree"),
    [
        ("splat/tree_10k.splat", 10_000, 0),
        ("splat/train_1000_sh3.ply", 1_000, 3),
        ("splat/khr_conformance_matrix.glb", 15, 3),
        ("scan/tls_tree_1.txt", 30_826, 0),
    ],
)
def test_every_real_cloud_is_read(samples, name: str, count: int, degree: int) -> None:
    with (samples / name).open("rb") as stream:
        cloud = read_cloud(stream, file_type=name.rsplit(".", 1)[1])
    assert (cloud.num_gaussians, cloud.sh_degree) == (count, degree)
    if "tree" in name:
        assert np.ptp(cloud.means[:, 2]) > np.ptp(cloud.means[:, :2], axis=0).max()  # it stands


def test_the_conformance_matrix_reads_the_same_value_from_every_type(samples) -> None:
    with (samples / "splat/khr_conformance_matrix.glb").open("rb") as stream:
        cloud = read_cloud(stream, file_type="glb")
    np.testing.assert_allclose(cloud.opacity[[0, 9, 10]], 0.25, atol=2e-3)
    np.testing.assert_allclose(covariances(cloud)[:3], covariances(cloud)[[0, 0, 0]], rtol=1e-3)
    np.testing.assert_allclose(cloud.means, np.tile([[1, -3, 2]], (15, 1)))
    np.testing.assert_allclose(np.log(cloud.scales[4]), [1, -2, 3], rtol=1e-5)


def _plain_ply(names: list[str], rows: np.ndarray) -> io.BytesIO:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property float {name}" for name in names]
    camera = "element intrinsic 2\nproperty float intrinsic\nend_header\n"  # SHARP writes its camera behind
    return io.BytesIO("\n".join([*lines, camera]).encode() + rows.astype("<f4").tobytes() + bytes(8))


PLACE, TURN = ["x", "y", "z", "opacity"], [f"rot_{i}" for i in range(4)]
DISC, HARMONIC = ["scale_0", "scale_1"], [f"f_dc_{i}" for i in range(3)]


def test_rows_of_a_splat_that_are_not_finite_are_left_out_and_counted() -> None:
    names = [*PLACE, *TURN, *DISC, "scale_2", *HARMONIC]
    rows = np.random.default_rng(0).normal(size=(9, len(names)))
    rows[2, 0], rows[4, 5], rows[6, -1], rows[7, 4:8] = np.nan, np.inf, -np.inf, 0
    cloud = read_cloud(_plain_ply(names, rows), file_type="ply", up_axis="+Z")
    assert (cloud.num_gaussians, cloud.dropped) == (5, 4)
    np.testing.assert_allclose(cloud.means, rows[[0, 1, 3, 5, 8], :3], rtol=1e-6)


def test_discs_with_two_scales_and_plain_colours_are_read() -> None:
    names = [*PLACE, *TURN, *DISC, "red", "green", "blue"]
    rows = np.random.default_rng(0).normal(size=(9, len(names)))
    rows[:, -3:] = (110, 75, 45)
    cloud = read_cloud(_plain_ply(names, rows), file_type="ply", up_axis="+Z")
    np.testing.assert_allclose(cloud.scales[:, :2], np.exp(rows[:, 8:10]), rtol=1e-5)
    assert cloud.scales[:, 2].max() < 1e-9
    np.testing.assert_allclose(cloud.sh[:, 0] * SH_0 + 0.5, np.tile(np.array([110, 75, 45]) / 255, (9, 1)), atol=1e-5)
