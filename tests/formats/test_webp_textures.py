"""GLB with EXT_texture_webp: which textures become WebP, what they show, and what stays as it was."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynamictree.export.write import write_products
from dynamictree.formats.gltf.webp import webp_textures
from dynamictree.requests import ExportParams, Format
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize
from tests.formats.artists import Artist, document_of
from tests.formats.meshes import read
from tests.js_tools import validated

WEBP = "EXT_texture_webp"


def bark(side_px: int = 128, *, alpha: bool = False) -> Image.Image:
    """A picture with soft stripes, as of bark; with cut-out round leaves."""
    y, x = np.mgrid[0:side_px, 0:side_px] / side_px
    grain = np.random.default_rng(1).normal(0, 6, (side_px, side_px))
    rgb = np.stack([120 + 60 * np.sin(20 * x), 90 + 40 * np.cos(9 * y), 60 + 30 * np.sin(30 * x * y)], axis=2)
    picture = np.clip(rgb + grain[..., None], 0, 255).astype(np.uint8)
    if not alpha:
        return Image.fromarray(picture)
    inside = ((x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.2).astype(np.uint8) * 255
    return Image.fromarray(np.dstack([picture, inside]))


def noise() -> Image.Image:
    return Image.fromarray(np.random.default_rng(2).integers(0, 255, (64, 64, 3)).astype(np.uint8))


def bytes_of(image: Image.Image, kind: str, **options: int) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def tree_of(pictures: dict[str, bytes]) -> bytes:
    """A cone whose material has these textures, by the name of their use."""
    artist = Artist()
    uses: dict[str, dict[str, int]] = {}
    for name, content in pictures.items():
        kind = "png" if content[:4] == b"\x89PNG" else "jpeg"
        image = artist.add("images", {"bufferView": artist.view(content), "mimeType": f"image/{kind}"})
        uses[name] = {"index": artist.add("textures", {"source": image})}
    surface = {name: uses.pop(name) for name in ("baseColorTexture", "metallicRoughnessTexture") if name in uses}
    material = artist.add("materials", {"pbrMetallicRoughness": surface} | uses)
    mesh = artist.add("meshes", {"primitives": [artist.cone(material)]})
    artist.add("nodes", {"mesh": mesh})
    return artist.glb()


def written(glb: bytes, folder: Path, *formats: Format, **options: object) -> dict[str, bytes]:
    """Products by format, `glb` if none is named."""
    mesh = read(glb, "glb")
    grid = voxelize(mesh, 32).grid
    coefficients = np.zeros((len(grid), 3, 3), np.complex64)
    coefficients[:, 1, 0] = 0.05 * grid.centres_m[:, 2]
    spectrum = SparseVoxelSpectrum(grid=grid, coefficients=coefficients, num_frames=4)
    params = ExportParams(formats=formats or ("glb",), joints=32, **options)
    return {name: path.read_bytes() for name, path in write_products(mesh, spectrum, params, folder).items()}


def images_of(glb: bytes) -> list[tuple[str, bytes]]:
    document = document_of(glb)
    return [(image["mimeType"], document.bytes_of(image["bufferView"])) for image in document.root["images"]]


def pixels(content: bytes, mode: str = "RGB") -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)).convert(mode)).astype(int)


PICTURES = {
    "baseColorTexture": bytes_of(bark(alpha=True), "PNG"),
    "normalTexture": bytes_of(bark(), "PNG"),
    "emissiveTexture": bytes_of(noise(), "JPEG", quality=10),
}


@pytest.mark.parametrize("compression", ["none", "meshopt"])
def test_textures_become_webp_where_that_is_smaller(tmp_path, compression: str) -> None:
    plain = written(tree_of(PICTURES), tmp_path)["glb"]
    packed = written(tree_of(PICTURES), tmp_path, glb_textures="webp", glb_compression=compression)["glb"]
    assert len(packed) < len(plain)
    assert read(packed, "glb").look.materials[0].texture_png is not None
    root = document_of(packed).root
    assert WEBP in root["extensionsUsed"]
    assert WEBP in root["extensionsRequired"]
    (color_type, color), (normal_type, normal), (small_type, small) = images_of(packed)
    assert (color_type, normal_type, small_type) == ("image/webp", "image/webp", "image/jpeg")
    assert len(color) < len(PICTURES["baseColorTexture"])
    was = pixels(PICTURES["baseColorTexture"], "RGBA")
    became = pixels(color, "RGBA")
    np.testing.assert_array_equal(became[..., 3], was[..., 3])
    assert 0 < np.abs(became - was)[..., :3].mean() < 6
    np.testing.assert_array_equal(pixels(normal), pixels(PICTURES["normalTexture"]))
    assert small == PICTURES["emissiveTexture"]


def test_an_image_that_cannot_be_decoded_or_has_another_beside_it_stays() -> None:
    png = bytes_of(bark(), "PNG")
    contents = [png[:200], png, png]
    textures = [{"source": 0}, {"source": 1, "extensions": {"KHR_texture_basisu": {"source": 2}}}]
    root = {"images": [{"mimeType": "image/png"}] * 3, "textures": textures}
    before = json.dumps(root)
    webp_textures(root, contents)
    assert json.dumps(root) == before
    assert contents == [png[:200], png, png]


@pytest.mark.slow
def test_the_validator_finds_no_error(tmp_path) -> None:
    paths = []
    for compression in ("none", "meshopt"):
        options = {"glb_textures": "webp", "glb_compression": compression}
        paths.append(tmp_path / f"{compression}.glb")
        paths[-1].write_bytes(written(tree_of(PICTURES), tmp_path, **options)["glb"])
    reports = validated(paths)
    assert [report["numErrors"] for report in reports] == [0] * len(paths), reports
