"""A stored photo contains no place and is the same picture."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from service.http.multipart import ReceivedFile
from service.http.problems import ProblemError
from service.uploads.exif_privacy import without_location
from tests.formats.meshes import written

GPS, ORIENTATION, FOCAL = 0x8825, 0x0112, 0xA405
XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/">GPSLatitude 48.13</x:xmpmeta>'


def received(path: Path) -> ReceivedFile:
    content = path.read_bytes()
    return ReceivedFile(name=path.name, path=path, sha256=sha256(content).hexdigest(), bytes=len(content))


def photo(path: Path, *, gps: bool = True, **options: object) -> ReceivedFile:
    exif = Image.Exif()
    if path.suffix != ".heic":  # there the picture itself is turned
        exif[ORIENTATION] = 6
    exif.get_ifd(0x8769)[FOCAL] = 50
    if gps:
        exif.get_ifd(GPS).update({1: "N", 2: (48.0, 8.0, 13.25), 3: "E", 4: (11.0, 34.0, 31.5), 29: "2026:11:21"})
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    if path.suffix == ".heic":
        options |= {"format": "HEIF"}
    Image.fromarray(pixels).save(path, exif=exif.tobytes(), **options)
    return received(path)


def text_of(name: str) -> dict[str, object]:
    """Options by which a picture of this name carries XMP."""
    if name != "a.png":
        return {"xmp": XMP}
    text = PngImagePlugin.PngInfo()
    text.add_itxt("XML:com.adobe.xmp", XMP.decode())
    return {"pnginfo": text}


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp", "a.heic"])
def test_the_place_is_gone_and_the_rest_is_there(tmp_path, name):
    before = photo(tmp_path / name, **text_of(name))
    content = before.path.read_bytes()
    assert b"2026:11:21" in content
    assert b"GPSLatitude" in content
    with Image.open(before.path) as image:
        pixels, exif = np.asarray(image), dict(image.getexif())
    after = without_location(before)
    content = after.path.read_bytes()
    assert b"2026:11:21" not in content
    assert b"GPSLatitude" not in content
    assert len(content) == after.bytes == before.bytes
    assert after.sha256 == sha256(content).hexdigest() != before.sha256
    with Image.open(after.path) as image:
        assert not image.getexif().get_ifd(GPS)
        assert image.getexif().get(ORIENTATION) == exif.get(ORIENTATION)
        assert image.getexif().get_ifd(0x8769)[FOCAL] == 50
        assert np.array_equal(np.asarray(image), pixels)
    assert without_location(after) == after


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp", "a.tif", "a.heic"])
def test_a_photo_that_tells_none_is_left_alone(tmp_path, name):
    before = photo(tmp_path / name, gps=False)
    assert without_location(before) == before


def test_the_place_is_gone_from_a_tiff(tmp_path):
    path = tmp_path / "a.tif"
    path.write_bytes(exif_of_a_place(b"<x>GPSLatitude</x>").removeprefix(b"Exif\0\0"))  # a TIFF of directories alone
    content = without_location(received(path)).path.read_bytes()
    assert b"2026:11:21" not in content
    assert b"GPSLatitude" not in content
    again = Image.Exif()
    again.load(content)
    assert again[ORIENTATION] == 6
    assert not again.get_ifd(GPS)


@pytest.mark.filterwarnings("ignore::UserWarning:PIL")  # tags are broken on purpose
@pytest.mark.parametrize("at", range(0, 90, 3))
def test_broken_exif_never_breaks_it_and_never_tells(tmp_path, at):
    before = photo(tmp_path / "a.jpg")
    content = bytearray(before.path.read_bytes())
    content[30 + at] = 0xFE
    before.path.write_bytes(bytes(content))
    after = without_location(received(before.path))
    assert after.bytes == len(content)
    with Image.open(after.path) as image:
        assert image.size == (64, 48)


def test_a_file_that_only_begins_as_a_jpeg_is_left_alone(tmp_path):
    path = tmp_path / "a.jpg"
    path.write_bytes(b"\xff\xd8\xff\xe1\xff")
    before = received(path)
    assert without_location(before) == before


def exif_of_a_place(xmp: bytes | None = None) -> bytes:
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    exif.get_ifd(GPS).update({1: "N", 2: (48.0, 8.0, 13.25), 29: "2026:11:21"})
    if xmp:
        exif[700] = xmp
    return exif.tobytes()


def jpeg(**options: object) -> bytes:
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    return written(Image.fromarray(pixels).save, format="JPEG", **options)


def places_in_a_jpeg() -> dict[str, bytes]:
    located, plain = jpeg(exif=exif_of_a_place()), jpeg(progressive=True)
    at = located.index(b"\xff\xe1")
    segment = located[at : at + 2 + int.from_bytes(located[at + 2 : at + 4], "big")]
    second_scan = plain.index(b"\xff\xda", plain.index(b"\xff\xda") + 2)
    return {
        "after fill bytes": located[:2] + b"\xff\xff\xff" + located[2:],
        "between scans": plain[:second_scan] + segment + plain[second_scan:],
        "before the end": plain[:-2] + segment + plain[-2:],
        "in a second picture": plain + located,
        "in a film behind": plain + b"....ftypmp42....\xa9xyz 2026:11:21 +48.1+11.5/",
    }


@pytest.mark.parametrize("where", places_in_a_jpeg())
def test_a_jpeg_tells_no_place_wherever_it_stands(tmp_path, where):
    content = places_in_a_jpeg()[where]
    assert b"2026:11:21" in content
    path = tmp_path / "a.jpg"
    path.write_bytes(content)
    pixels = np.asarray(Image.open(path))
    after = without_location(received(path))
    assert b"2026:11:21" not in path.read_bytes()
    assert after.sha256 == sha256(path.read_bytes()).hexdigest()
    assert np.array_equal(np.asarray(Image.open(path)), pixels)


def test_every_page_of_a_tiff_tells_no_place(tmp_path):
    located = exif_of_a_place().removeprefix(b"Exif\0\0")  # MM, 42, 8: its directory comes first
    path = tmp_path / "a.tif"
    pages = bytearray(located[:4] + len(located).to_bytes(4, "big") + located[8:])
    path.write_bytes(bytes(pages) + b"\0\0" + (8).to_bytes(4, "big"))  # an empty page, then that of the place
    without_location(received(path))
    assert b"2026:11:21" not in path.read_bytes()


def test_a_tiff_of_another_form_is_refused(tmp_path):
    path = tmp_path / "a.tif"
    path.write_bytes(b"II+\0\x08\0\0\0" + bytes(60))
    with pytest.raises(ProblemError, match="BigTIFF; save it as TIFF"):
        without_location(received(path))
