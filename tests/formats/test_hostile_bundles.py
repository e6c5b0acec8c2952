"""SOG bundles and .ksplat files that contradict themselves are refused with the place, before anything is allocated."""

import io
import json
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.source_file import read_capture
from dynamictree.formats.splat.sog import write_sog
from tests.formats.ksplat_bytes import ksplat_bytes
from tests.formats.meshes import written, zipped
from tests.formats.test_cloud_round_trips import make_cloud

Files = dict[str, bytes]
Meta = dict[str, Any]
packed = partial(zipped, kind=zipfile.ZIP_STORED)


@pytest.fixture(scope="module")
def files() -> Files:
    """Of a sound bundle of 300 Gaussians of degree 1."""
    stream = io.BytesIO()
    write_sog(make_cloud(np.random.default_rng(1), degree=1), stream)
    with zipfile.ZipFile(stream) as archive:
        assert not archive.testzip()
        assert {entry.date_time[0] for entry in archive.infolist()} == {1980}  # the same bytes on any day
        return {name: archive.read(name) for name in archive.namelist()}


def picture(width: int, height: int, alpha: int = 255) -> bytes:
    return written(Image.new("RGBA", (width, height), (9, 0, 0, alpha)).save, format="WEBP", lossless=True)


def put(name: str, **values: object) -> Callable[[Meta], None]:
    """Change fields of a part of `meta.json`, or of itself where no part is named."""

    def change(meta: Meta) -> None:
        (meta[name] if name else meta).update(values)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("", version=3), "of version 3; 2 is understood"),
        (put("", count=0), "the cloud is empty"),
        (put("", count=50_000_000), "50,000,000 Gaussians"),
        (put("", count=4_000_000), "at most 100:1"),
        (put("", count=100_000), "pixels; 100,000 are needed"),
        (put("", count=2.5), "a whole number"),
        (put("means", files=["means_l.webp"]), "lacks picture 2 of means"),
        (put("means", files=["../means_l.webp", "means_u.webp"]), "lacks picture 1 of means"),
        (put("means", mins=[0, 0]), "mins has 2 numbers; 3"),
        (put("means", maxs=[1e9, 1, 1]), "means of .* not finite"),
        (put("scales", codebook=[0.0] * 255), "255 numbers; 256"),
        (put("scales", codebook=[1e200] * 256), "scales of .* not finite"),
        (put("sh0", files=["meta.json"]), "no image of WEBP"),
        (put("shN", bands=4), "from 0 to 3"),
        (put("shN", bands=3), "pixels|the SOG palette is"),
        (put("shN", count=70_000), "from 0 to 65536"),
        (put("shN", count=64), "names palette entry 299 of 64"),
    ],
)
def test_a_contradictory_sog_is_reported_with_the_place(
    files: Files, change: Callable[[Meta], None], message: str
) -> None:
    meta = json.loads(files["meta.json"])
    change(meta)
    with pytest.raises(InputError, match=message):
        read_cloud(io.BytesIO(packed(files | {"meta.json": json.dumps(meta).encode()})), file_type="sog")


def test_a_sog_archive_has_bounds(files: Files) -> None:
    def refused(content: bytes, message: str) -> None:
        with pytest.raises(FormatError, match=message):
            read_cloud(io.BytesIO(content), file_type="sog")

    refused(b"", "no ZIP archive")
    refused(packed(files)[:-40], "no ZIP archive")
    refused(packed({"a.txt": b""}), "JSON of the meta.json cannot be read")
    refused(packed(files | {f"{n}.txt": b"" for n in range(64)}), "at most 64 files")
    refused(zipped(files | {"zeros": bytes(30 << 20)}), "100:1 is allowed")
    refused(packed(files | {"meta.json": b" " * (2 << 20)}), "larger than the 1,048,576 bytes")
    refused(packed(files | {"quats.webp": picture(300, 300)}), "300 x 300 pixels")
    refused(packed(files | {"quats.webp": files["quats.webp"][:60]}), "is damaged")
    refused(packed(files | {"shN_centroids.webp": picture(96, 10)}), "palette is 96 x 10; 192 x 5")


def test_a_rotation_of_no_known_kind_is_none(files: Files) -> None:
    cloud = read_cloud(io.BytesIO(packed(files | {"quats.webp": picture(20, 20, 7)})), file_type="sog")
    np.testing.assert_allclose(np.abs(cloud.quaternions[0]), np.abs(cloud.quaternions[-1]))


def test_a_sog_folder_is_read_as_its_bundle(files: Files, tmp_path) -> None:
    whole = read_capture(io.BytesIO(packed(files)), file_type="sog").cloud
    folder = read_capture(io.BytesIO(files["meta.json"]), file_type="sog", companions=files).cloud
    np.testing.assert_array_equal(folder.means, whole.means)
    with pytest.raises(FormatError, match=r"lacks picture 1 of sh0: meta\.json names 'sh0\.webp'"):
        read_capture(
            io.BytesIO(files["meta.json"]),
            file_type="sog",
            companions={name: content for name, content in files.items() if name != "sh0.webp"},
        )


def changed(place: int, kind: str, value: float, *, level: int = 1, degree: int = 0) -> bytes:
    content = bytearray(ksplat_bytes(make_cloud(np.random.default_rng(1), degree=degree), level))
    struct.pack_into(kind, content, place, value)
    return bytes(content)


SECTION = 4096


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "its header alone"),
        (changed(0, "<B", 1), "version 1.1 and compression level 1"),
        (changed(20, "<H", 3), "compression level 3"),
        (changed(16, "<I", 0), "the cloud is empty"),
        (changed(16, "<I", 50_000_000), "50,000,000 Gaussians"),
        (changed(16, "<I", 299), "says 299 Gaussians, its sections have 300"),
        (changed(4, "<I", 1 << 30), "more than fit into it"),
        (changed(SECTION, "<I", 151), "151 Gaussians in room for 150"),
        (changed(SECTION + 4, "<I", 1 << 31), "section 0 .* ends at"),
        (changed(SECTION + 12, "<I", 1), "2 full and 1 other of 1 buckets"),
        (changed(SECTION + 12, "<I", 1 << 30), "section 0 .* ends at"),
        (changed(SECTION + 8, "<I", 1 << 31), "hold 4,294,967,318 Gaussians; 150 are there"),
        (changed(SECTION + 16, "<f", np.nan), "buckets of nan"),
        (changed(SECTION + 20, "<H", 4), "contradicts itself"),
        (changed(SECTION + 40, "<H", 3), "harmonics of degree 3"),
        (changed(36, "<f", np.inf, level=2, degree=1), "which is no range"),
        (changed(SECTION + 2 * 1024, "<I", 1 << 31), "hold 2,147,483,776 Gaussians"),
    ],
)
def test_a_contradictory_ksplat_is_reported_with_the_place(content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_cloud(io.BytesIO(content), file_type="ksplat")
