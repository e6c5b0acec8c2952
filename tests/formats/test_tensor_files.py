"""Spectrum and voxel files: read undoes write, and nothing in a hostile file gets through."""

import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load, save

from dynamictree.errors import FormatError, InputError, NumericsError
from dynamictree.formats.tensors import container
from dynamictree.formats.tensors.spectrum import read_spectrum, write_spectrum
from dynamictree.formats.tensors.voxels import read_voxels, write_voxels
from dynamictree.source import Source
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import moments_of_normals
from dynamictree.voxel.voxelize import SurfaceVoxels
from tests.formats.meshes import written

GOLDEN = Path(__file__).parent.parent / "golden"


def small_spectrum(rng: np.random.Generator, num_voxels: int = 50) -> SparseVoxelSpectrum:
    grid = VoxelGrid.from_coords(
        rng.integers(0, 64, (num_voxels, 3)).astype(np.int32),
        origin_m=(-1.5, 0.1, 1 / 3),
        voxel_size_m=0.1234567890123,
        resolution=64,
    )
    parts = 0.1 * rng.normal(size=(len(grid), 16, 3, 2)).astype(np.float16).astype(np.float32)
    return SparseVoxelSpectrum(
        grid=grid,
        coefficients=parts.astype(np.float16).astype(np.float32).view(np.complex64)[..., 0],
        fps=30.0,
        num_frames=120,
        rest="mean",
        model="small-1",
        seed=2**40,
        wind=Wind(speed_m_s=7.5, direction_deg=-90.0, gust=0.2),
        source=Source(sha256="0123456789abcdef" * 4),
    )


def spectrum_bytes(spectrum: SparseVoxelSpectrum, dtype: str = "float16") -> bytes:
    return written(write_spectrum, spectrum, dtype=dtype)


def with_changes(content: bytes, tensors: Mapping[str, np.ndarray | None], metadata: Mapping[str, str | None]) -> bytes:
    """The same file with some tensors or fields replaced, or taken out where None."""
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    all_metadata = header["__metadata__"] | dict(metadata)
    all_tensors = load(content) | dict(tensors)
    return save(
        {name: value for name, value in all_tensors.items() if value is not None},
        {name: value for name, value in all_metadata.items() if value is not None},
    )


def assert_same(result: SparseVoxelSpectrum, expected: SparseVoxelSpectrum) -> None:
    np.testing.assert_array_equal(result.grid.coords, expected.grid.coords)
    np.testing.assert_array_equal(result.coefficients, expected.coefficients)
    assert replace(result, grid=expected.grid, coefficients=expected.coefficients) == expected
    assert result.grid.origin_m == expected.grid.origin_m
    assert result.grid.voxel_size_m == expected.grid.voxel_size_m
    assert result.grid.resolution == expected.grid.resolution


@pytest.mark.parametrize("absent", [{}, {"wind": None, "source": Source(), "model": ""}])
@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_read_undoes_write_and_the_bytes_are_always_the_same(rng, dtype: str, absent: dict[str, object]) -> None:
    spectrum = replace(small_spectrum(rng), **absent)
    content = spectrum_bytes(spectrum, dtype)
    assert_same(read_spectrum(io.BytesIO(content)), spectrum)
    assert spectrum_bytes(spectrum, dtype) == content


def test_the_golden_file_of_version_1_stays_readable() -> None:
    with (GOLDEN / "spectrum-v1.safetensors").open("rb") as stream:
        assert_same(read_spectrum(stream), small_spectrum(np.random.default_rng(1)))


@pytest.mark.parametrize(
    ("value", "dtype", "message"), [(1e5, "float16", "float16 holds at most"), (np.nan, "float32", "nan m")]
)
def test_what_a_file_cannot_hold_is_not_written(rng, value: float, dtype: str, message: str) -> None:
    spectrum = small_spectrum(rng)
    spectrum.coefficients[3, 2, 1] = value
    with pytest.raises(NumericsError, match=message):
        spectrum_bytes(spectrum, dtype)


@pytest.mark.parametrize(
    ("tensors", "metadata", "message"),
    [
        ({}, {"format": "surface-voxels"}, "format"),
        ({}, {"version": "2"}, "version is '2'"),
        ({"coords": None}, {}, "no tensor 'coords'"),
        ({"coords": np.zeros((4, 2), np.int32)}, {}, r"\[4, 2\]"),
        ({"coords": np.zeros((4, 3), np.float32)}, {}, "float32"),
        ({"coords": np.zeros((0, 3), np.int32)}, {}, "empty"),
        ({"coords": np.zeros((2, 3), np.int32)}, {}, "unique"),
        ({"coords": np.array([[0, 0, 64]], np.int32)}, {}, "0 to 63"),
        ({"coords": np.array([[0, 0, 1]], np.int32)}, {}, r"\[1, 'any', 3, 2\]"),
        ({"coefficients": np.full((50, 16, 3, 2), np.nan, np.float16)}, {}, "not finite"),
        ({"coefficients": np.zeros((50, 0, 3, 2), np.float16)}, {}, "0 frequencies"),
        ({}, {"num_frames": "20"}, "16 frequencies"),
        ({}, {"num_frames": "9" * 4000}, "num_frames"),
        ({}, {"num_frames": "9" * 5000}, "5000 characters"),
        ({}, {"num_frames": None}, "num_frames"),
        ({}, {"fps": "NaN"}, "fps"),
        ({}, {"fps": "[24]"}, "fps"),
        ({}, {"resolution": "100000"}, "resolution"),
        ({}, {"voxel_size_m": "-1"}, "voxel_size_m"),
        ({}, {"voxel_size_m": "9" * 400}, "voxel_size_m"),
        ({}, {"origin_m": "[0, 0]"}, "origin_m"),
        ({}, {"origin_m": '[0, 0, "a"]'}, "origin_m"),
        ({}, {"origin_m": "[0, 0,"}, "origin_m"),
        ({}, {"origin_m": "[" * 4000}, "origin_m"),
        ({}, {"rest": "lying"}, "rest"),
        ({}, {"seed": "0.5"}, "seed"),
        ({}, {"wind": '{"speed_m_s": 1}'}, "wind"),
        ({}, {"wind": '{"speed_m_s": 1, "direction_deg": NaN, "gust": 1}'}, "wind"),
        ({}, {"model": "a\nb"}, "model"),
        ({}, {"source_sha256": "xyz"}, "source_sha256"),
    ],
)
def test_a_spectrum_file_that_was_tampered_with_is_refused(
    tensors: Mapping[str, np.ndarray | None], metadata: Mapping[str, str | None], message: str
) -> None:
    content = spectrum_bytes(small_spectrum(np.random.default_rng(1)))
    with pytest.raises(InputError, match=message):
        read_spectrum(io.BytesIO(with_changes(content, tensors, metadata)))


def test_what_is_not_safetensors_is_refused(rng) -> None:
    content = spectrum_bytes(small_spectrum(rng))
    for broken in (b"", b"glTF", content[:100], content[:-1], b"\xff" * 100):
        with pytest.raises(FormatError, match="safetensors"):
            read_spectrum(io.BytesIO(broken))


def test_a_file_without_metadata_or_over_the_cap_is_refused(rng) -> None:
    with pytest.raises(FormatError, match="format is 'None'"):
        read_spectrum(io.BytesIO(save({"coords": np.zeros((1, 3), np.int32)})))
    stream = io.BytesIO(spectrum_bytes(small_spectrum(rng)))
    with pytest.raises(FormatError, match="1,000 bytes"):
        container.read_tensors(stream, file_format="sparse-voxel-spectrum", version="1", max_bytes=1000)


def small_voxels(rng: np.random.Generator) -> SurfaceVoxels:
    grid = small_spectrum(rng).grid
    normals = rng.normal(size=(len(grid), 3))
    unit = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)
    source = Source(up_axis="+Y", up_confidence=1.0, scale=0.01)
    return SurfaceVoxels(grid=grid, normals=unit, moments=moments_of_normals(unit), source=source)


def test_read_voxels_undoes_write_voxels(rng) -> None:
    voxels = small_voxels(rng)
    result = read_voxels(io.BytesIO(written(write_voxels, voxels)))
    np.testing.assert_array_equal(result.grid.coords, voxels.grid.coords)
    np.testing.assert_array_equal(result.normals, voxels.normals)
    np.testing.assert_array_equal(result.moments, voxels.moments)
    assert result.grid.origin_m == voxels.grid.origin_m
    assert result.source == voxels.source
    assert read_voxels(io.BytesIO(written(write_voxels, replace(voxels, moments=None)))).moments is None
    with pytest.raises(FormatError, match="'surface-voxels'"):
        read_voxels(io.BytesIO(spectrum_bytes(small_spectrum(rng))))


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("moments", np.zeros((50, 16), np.float32)),
        ("moments", np.full((50, 16), 2, np.float32)),
        ("moments", np.ones((50, 9), np.float32)),
        ("normals", np.full((50, 3), 5, np.float32)),
        ("normals", np.zeros((3, 3), np.float32)),
    ],
)
def test_rows_of_voxels_that_are_none_are_refused(name: str, rows: np.ndarray) -> None:
    content = written(write_voxels, small_voxels(np.random.default_rng(1)))
    with pytest.raises(FormatError, match=name.removesuffix("s")):
        read_voxels(io.BytesIO(with_changes(content, {name: rows}, {})))
