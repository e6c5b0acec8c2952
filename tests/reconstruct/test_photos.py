import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import FormatError, InputError
from dynamictree.reconstruct.photos import MAX_PHOTO_BYTES, Photo, list_photos, sizes_of
from dynamictree.reconstruct.photos import prepare_photos as prepare_listed


def prepare_photos(paths: list[Path], folder: Path, **options: object) -> list[Photo]:
    return prepare_listed(list_photos(paths), folder, **options)


def save_photo(path: Path, size: tuple[int, int] = (400, 300), **options: object) -> Path:
    rng = np.random.default_rng(zlib.crc32(path.name.encode()))
    pixels = rng.integers(0, 255, (size[1], size[0], 3)).astype(np.uint8)
    Image.fromarray(pixels).save(path, **options)
    return path


@pytest.fixture
def eight(tmp_path) -> list[Path]:
    return [save_photo(tmp_path / f"{number}.jpg") for number in range(8)]


def declared_png(path: Path, width: int, height: int) -> Path:
    """A PNG whose header declares a size that its content has not."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 64)) + chunk(b"IEND", b""))
    return path


def test_photos_keep_their_order_and_are_reduced(tmp_path, eight):
    eight[3] = save_photo(tmp_path / "large.png", (2400, 1200))
    sizes = []
    prepared = prepare_photos(eight, tmp_path / "out", on_photo=lambda done, total: sizes.append((done, total)))
    assert [photo.source for photo in prepared] == [path.name for path in eight]
    assert (prepared[3].width, prepared[3].height) == (1200, 600)
    [fine] = prepare_listed(list_photos(eight, side_px=1600), tmp_path / "fine")[3:4]
    assert (fine.width, fine.height) == (1600, 800)
    assert (prepared[0].width, prepared[0].height) == (400, 300)
    assert sizes == [(number, 8) for number in range(9)]
    for photo in prepared:
        with Image.open(tmp_path / "out" / photo.name) as image:
            assert image.format == "JPEG"
            assert image.size == (photo.width, photo.height)


@pytest.mark.parametrize(("name", "kind"), [("turned.jpg", "JPEG"), ("IMG_0002.HEIC", "HEIF")])
def test_exif_turns_the_photo_gives_its_focal_length_and_is_left_behind(tmp_path, eight, name, kind):
    """A folder of HEIC was "0 photos", and beside JPEG they vanished."""
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera stood upright: turn by 90 degrees
    exif.get_ifd(0x8769)[0xA405] = 50  # focal length in 35 mm film
    exif.get_ifd(0x8825)[1] = "N"  # GPS
    pixels = np.zeros((300, 400, 3), np.uint8)
    pixels[:, :100, 0] = 255
    eight[2] = tmp_path / name
    Image.fromarray(pixels).save(eight[2], format=kind, exif=exif.tobytes())
    photo = prepare_photos(eight, tmp_path / "out")[2]
    assert (photo.width, photo.height) == (300, 400)
    assert photo.focal_px == pytest.approx(50 / 36 * 400)
    with Image.open(tmp_path / "out" / photo.name) as image:
        assert np.asarray(image)[:90, :, 0].min() > 200  # what was left is on top
        assert not dict(image.getexif())
    assert b"Exif" not in (tmp_path / "out" / photo.name).read_bytes()


def test_refuses_copies_of_one_photo(tmp_path, eight):
    copies = [tmp_path / f"copy{number}.jpg" for number in range(40)]
    for copy in copies:
        copy.write_bytes(eight[0].read_bytes())
    with pytest.raises(InputError, match="46 photos were given and 7 of them differ; 8 must"):
        prepare_photos([*eight[:6], *copies[:39], eight[6]], tmp_path / "out")


@pytest.mark.parametrize("focal", [None, 0, 60000, "fifty"])
def test_a_focal_length_that_no_lens_has_is_not_believed(tmp_path, eight, focal):
    exif = Image.Exif()
    if focal is not None:
        exif.get_ifd(0x8769)[0xA405] = focal
    eight[0] = save_photo(tmp_path / "odd.jpg", exif=exif)
    assert prepare_photos(eight, tmp_path / "out")[0].focal_px is None


@pytest.mark.parametrize("number", [0, 1, 7, 301])
def test_refuses_too_few_and_too_many(tmp_path, eight, number):
    with pytest.raises(InputError, match=f"^{number} photos were given; 8 to 300"):
        prepare_photos((eight * 50)[:number], tmp_path / "out")


def masks_of_another_shape(folder: Path, photos: list[Path]) -> None:
    (folder / "masks").mkdir()
    for path in photos:
        save_photo(folder / "masks" / f"{path.stem}.png", (300, 300))


UNUSABLE = {
    "no photo": (lambda folder, photos: photos[2].write_text("solid tree"), r"2\.jpg is none of JPEG, PNG, WEBP, TIFF"),
    "bmp": (lambda folder, photos: save_photo(photos[2], format="BMP"), "is none of JPEG, PNG, WEBP, TIFF, HEIF"),
    "truncated": (lambda folder, photos: os.truncate(photos[5], 9000), r"5\.jpg cannot be decoded"),
    "large": (lambda folder, photos: declared_png(photos[1], 9000, 9000), r"1\.jpg.*allowed"),
    "warned of by Pillow": (lambda folder, photos: declared_png(photos[1], 10_100, 10_100), r"1\.jpg.*allowed"),
    "refused by Pillow": (lambda folder, photos: declared_png(photos[1], 100_000, 100_000), r"1\.jpg.*allowed"),
    "narrow": (lambda folder, photos: declared_png(photos[1], 8000, 100), r"1\.jpg.*allowed"),
    "bytes": (lambda folder, photos: os.truncate(photos[6], MAX_PHOTO_BYTES + 1), r"6\.jpg has 67,108,865 bytes"),
    "mask": (masks_of_another_shape, r"the mask of 0\.jpg has 300 x 300 pixels"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_refuses_what_is_no_usable_photo(tmp_path, eight, name):
    change, message = UNUSABLE[name]
    change(tmp_path, eight)
    with pytest.raises(FormatError, match=message):
        prepare_listed(list_photos(eight, tmp_path), tmp_path / "out")


def test_heic_without_its_reader_says_what_to_install(tmp_path, eight, monkeypatch):
    save_photo(tmp_path / "a.heic", format="HEIF")
    monkeypatch.delitem(Image.OPEN, "HEIF")
    with pytest.raises(FormatError, match=r"a\.heic is HEIC.*dynamictree\[photos\]"):
        prepare_photos([*eight, tmp_path / "a.heic"], tmp_path / "out")


def test_what_the_callback_raises_passes_through(tmp_path, eight):
    class Stopped(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise Stopped

    with pytest.raises(Stopped):
        prepare_photos(eight, tmp_path / "out", on_photo=stop)
    assert len(list((tmp_path / "out").iterdir())) == 3


def test_masks_and_alpha_are_stored_beside_the_photo(tmp_path, eight):
    (tmp_path / "masks").mkdir()
    cut = np.zeros((300, 400), np.uint8)
    cut[100:200] = 255
    for path in eight:
        Image.fromarray(cut).save(tmp_path / "masks" / f"{path.stem}.png")
    photos = list_photos([*eight, *(tmp_path / "masks").iterdir()], tmp_path)
    assert [photo.name for photo in photos] == [path.name for path in eight]
    prepared = prepare_listed(photos, tmp_path / "out")
    assert all(photo.masked for photo in prepared)
    with Image.open(tmp_path / "out" / f"{prepared[3].name}.png") as mask:
        assert np.array_equal(np.asarray(mask), cut)
    (tmp_path / "masks" / "5.png").unlink()
    with pytest.raises(InputError, match=r"masks, but none for 5\.jpg"):
        list_photos(eight, tmp_path)


@pytest.mark.parametrize(
    ("folders", "taken"),
    [
        (["images", "images_4", "images_8"], "images"),
        (["images_4", "images_8"], "images_4"),
        (["images_8"], "images_8"),
        (["walk", "images_of_a_walk"], None),
    ],
)
def test_reduced_copies_of_photos_are_left_out(tmp_path, folders, taken):
    paths = []
    for folder in folders:
        (tmp_path / folder).mkdir()
        paths += [save_photo(tmp_path / folder / f"{number}.png", (40, 30)) for number in range(2)]
    listed = {photo.path.parent.name for photo in list_photos(paths, tmp_path)}
    assert listed == ({taken} if taken else set(folders))


@pytest.mark.parametrize(("alpha", "masked"), [(0, True), (254, True), (255, False)])
def test_an_alpha_channel_is_a_mask_unless_it_is_opaque(tmp_path, eight, alpha, masked):
    """Exported as RGBA without anything cut out: the whole picture would count as the tree."""
    pixels = np.full((300, 400, 4), 255, np.uint8)
    pixels[:, :100, 3] = alpha
    eight[1] = tmp_path / "cut.png"
    Image.fromarray(pixels).save(eight[1])
    prepared = prepare_photos(eight, tmp_path / "out")
    assert [photo.masked for photo in prepared] == [masked and number == 1 for number in range(8)]
    masks = [np.asarray(Image.open(path)) for path in (tmp_path / "out").glob("*.png")]
    assert [mask.tolist() for mask in masks] == [pixels[..., 3].tolist()] * masked


def test_masks_of_some_opaque_photos_are_of_all(tmp_path):
    paths = [tmp_path / f"{number}.png" for number in range(8)]
    for number, path in enumerate(paths):
        pixels = np.full((300, 400, 4), 255, np.uint8)
        pixels[0, number, 0], pixels[:, :100, 3] = number, 254 if number == 5 else 255
        Image.fromarray(pixels).save(path)
    assert all(photo.masked for photo in prepare_photos(paths, tmp_path / "out"))


def test_sizes_are_reported_as_stored_and_as_turned(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    (photo,) = list_photos([save_photo(tmp_path / "turned.jpg", exif=exif)])
    assert sizes_of(photo) == ((400, 300), (300, 400))


def test_grey_photos_of_16_bits_are_scaled_to_their_range(tmp_path, eight):
    ramp = np.tile(np.linspace(0, 65_535, 400).astype(np.uint16), (300, 1))
    Image.fromarray(ramp).save(eight[0].with_suffix(".png"))
    prepared = prepare_photos([eight[0].with_suffix(".png"), *eight[1:]], tmp_path / "out")
    with Image.open(tmp_path / "out" / prepared[0].name) as image:
        pixels = np.asarray(image.convert("L"), float)
    assert abs(pixels.mean() - 127.5) < 2
    assert abs(pixels[:, 100].mean() - 64) < 3
