"""Check photos, rotate them by EXIF, reduce them, and remove EXIF with its GPS position."""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from PIL import Image, ImageOps, UnidentifiedImageError

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.photo import PHOTO_FORMATS, open_photo
from dynamictree.formats.suffixes import MASKS
from dynamictree.formats.texture import in_eight_bits
from dynamictree.photo_requests import MAX_PHOTOS, MIN_PHOTOS, QUALITIES
from dynamictree.reconstruct.input_cameras import InputCamera, find_input_cameras, fits

MAX_PHOTO_BYTES = 64 * 2**20

_EXIF_IFD, _FOCAL_35MM, _ORIENTATION = 0x8769, 0xA405, 0x0112
_REDUCED = re.compile(r"(?P<name>images|rgb)(_(?P<by>[0-9]{1,2}))?")


@dataclass(frozen=True, kw_only=True)
class Photo:
    """Photo prepared for feature matching."""

    source: str  # the file's name as given
    name: str  # file name of the prepared photo, independent of the other photos
    width: int
    height: int
    focal_px: float | None  # focal length by EXIF, if any
    masked: bool = False  # `<name>.png` lies beside it, white where the tree is


@dataclass(frozen=True, kw_only=True)
class PhotoFile:
    """Original file of a photo."""

    path: Path
    name: str  # file name; with folders where two photos have the same
    mask: Path | None = None  # picture of the same size, white where the tree is
    side_px: int = QUALITIES["standard"].photo_px  # long side after reduction
    as_stored: bool = False  # ignore EXIF's orientation, since the given camera does


Given = tuple[InputCamera, ...] | None
OnPhoto = Callable[[int, int], None]
ReadPhotos = Callable[[Sequence[PhotoFile], Path | None, Path, OnPhoto], tuple[Given, list[Photo]]]


def list_photos(
    paths: Sequence[Path], root: Path | None = None, *, side_px: int = QUALITIES["standard"].photo_px
) -> list[PhotoFile]:
    """Name the photos, and find their masks: files of the same name or stem in a folder `masks`."""
    masks: dict[str, Path] = {}
    if root is not None:
        for path in sorted(root.rglob("*")):
            if path.parent.name == MASKS and path.is_file():
                masks[path.name] = masks[path.stem] = path
    photo_paths = [path for path in _without_reduced(paths) if root is None or path.parent.name != MASKS]
    alike = root is not None and len({path.name for path in photo_paths}) < len(photo_paths)
    photos = []
    for path in photo_paths:
        name = path.relative_to(root).as_posix() if root is not None and alike else path.name
        mask = masks.get(path.name) or masks.get(path.stem)
        photos.append(PhotoFile(path=path, name=name, mask=mask, side_px=side_px))
    if masks and not all(photo.mask for photo in photos):
        bare = next(photo.name for photo in photos if photo.mask is None)
        raise InputError(f"there are masks, but none for {bare}; give one a photo, of the same name, or none at all")
    return photos


def _without_reduced(paths: Sequence[Path]) -> list[Path]:
    """Leave out reduced copies of photos, which LLFF and nerfstudio store in folders such as `images_4`."""
    copies: dict[Path, list[int]] = {}
    for folder in {path.parent for path in paths}:
        if (match := _REDUCED.fullmatch(folder.name)) is not None:
            copies.setdefault(folder.with_name(match["name"]), []).append(int(match["by"] or 1))
    largest = {whole.with_name(whole.name + (f"_{min(by)}" if min(by) > 1 else "")) for whole, by in copies.items()}
    return [path for path in paths if _REDUCED.fullmatch(path.parent.name) is None or path.parent in largest]


def sizes_of(photo: PhotoFile) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return width and height as stored, and as rotated by EXIF.

    Raises:
        FormatError: the file is no photo, or is damaged, too large or too small.
    """
    sideways = (5, 6, 7, 8)
    with _opened(photo.path, photo.name) as image:
        stored = image.size
        try:
            turned = image.getexif().get(_ORIENTATION) in sideways  # decodes the whole picture if it is a PNG
        except (OSError, SyntaxError) as error:
            raise _undecodable(photo, error) from error
    return stored, (stored[::-1] if turned else stored)


def prepare_photos(
    photos: Sequence[PhotoFile], folder: Path, *, on_photo: Callable[[int, int], None] = lambda done, total: None
) -> list[Photo]:
    """Write an upright, reduced JPEG of each photo, without EXIF and so without GPS; retain the order.

    If a photo has an alpha channel or a mask, `<name>.png` is written beside it, white where the tree is; not if no
    pixel of any photo is transparent.

    Raises:
        InputError: too few or too many photos.
        FormatError: a file is no JPEG, PNG, WebP, TIFF or HEIC, is truncated, too large or too small; or the aspect
            ratio of a mask differs from its photo's.
    """
    advice = "walk around the tree and take one every 10 to 20 degrees"
    if not MIN_PHOTOS <= len(photos) <= MAX_PHOTOS:
        raise InputError(f"{len(photos)} photos were given; {MIN_PHOTOS} to {MAX_PHOTOS} are needed; {advice}")
    different = len({sha256(photo.path.read_bytes()).digest() for photo in photos})
    if different < MIN_PHOTOS:
        raise InputError(f"{len(photos)} photos were given and {different} of them differ; {MIN_PHOTOS} must; {advice}")
    folder.mkdir(parents=True, exist_ok=True)
    prepared = []
    for number, photo in enumerate(photos):
        on_photo(number, len(photos))
        prepared.append(_prepare(photo, folder, f"{sha256(photo.name.encode()).hexdigest()[:16]}.jpg"))
    on_photo(len(photos), len(photos))
    return prepared if _any_transparent(prepared, folder) else [replace(photo, masked=False) for photo in prepared]


def _any_transparent(prepared: list[Photo], folder: Path) -> bool:
    """Whether any mask has a transparent pixel; if not, delete the masks, since image editors may add opaque alpha."""
    opaque = 255  # alpha of an opaque pixel
    for photo in prepared:
        if photo.masked:
            with Image.open(folder / f"{photo.name}.png") as mask:
                if mask.getextrema()[0] != opaque:
                    return True
    for photo in prepared:
        (folder / f"{photo.name}.png").unlink(missing_ok=True)
    return False


def _prepare(photo: PhotoFile, folder: Path, name: str) -> Photo:
    film_width_mm = 36.0
    with _opened(photo.path, photo.name) as image:
        focal_35mm = _focal_35mm(image)
        upright = _decoded(image, photo, reduced=True)
        alpha = upright.getchannel("A") if upright.mode == "RGBA" else None
    if photo.mask is not None:
        with _opened(photo.mask, photo.mask.name) as image:
            alpha = _decoded(image, photo, reduced=False).convert("L")
        if abs(alpha.width * upright.height - alpha.height * upright.width) > 0.01 * alpha.width * upright.height:
            problem = f"the mask of {photo.name} has {alpha.width} x {alpha.height} pixels"
            raise FormatError(f"{problem}, its photo another shape; make masks of the photos as they are")
    upright = upright.convert("RGB")
    if max(upright.size) > photo.side_px:
        upright.thumbnail((photo.side_px, photo.side_px), Image.Resampling.LANCZOS)
    upright.save(folder / name, format="JPEG", quality=95, subsampling=0, exif=b"")
    if alpha is not None:
        alpha.resize(upright.size, Image.Resampling.BOX).save(folder / f"{name}.png")
    focal_px = None if focal_35mm is None else focal_35mm / film_width_mm * max(upright.size)
    return Photo(
        source=photo.name,
        name=name,
        width=upright.width,
        height=upright.height,
        focal_px=focal_px,
        masked=alpha is not None,
    )


def _decoded(image: Image.Image, photo: PhotoFile, *, reduced: bool) -> Image.Image:
    if reduced:
        image.draft("RGB", (photo.side_px, photo.side_px))  # decode a JPEG at the next larger of 1/2, 1/4, 1/8
    try:
        turned = in_eight_bits(image.copy() if photo.as_stored else ImageOps.exif_transpose(image))
        return turned.convert("RGBA" if "A" in turned.getbands() or "transparency" in turned.info else "RGB")
    except (OSError, SyntaxError) as error:
        raise _undecodable(photo, error) from error


def _undecodable(photo: PhotoFile, error: Exception) -> FormatError:
    return FormatError(f"{photo.name} cannot be decoded: {error}; copy it from the camera again")


@contextmanager
def _opened(path: Path, name: str) -> Iterator[Image.Image]:
    min_side_px = 240
    max_photo_pixels = 64_000_000  # size of the largest common cameras; decoding takes 200 MB
    size = path.stat().st_size
    if size > MAX_PHOTO_BYTES:
        raise FormatError(f"{name} has {size:,} bytes; a photo may have {MAX_PHOTO_BYTES:,}; reduce it")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit below is lower
            image = open_photo(path, name)
    except UnidentifiedImageError as error:
        raise FormatError(f"{name} is none of {', '.join(PHOTO_FORMATS)}; convert it to one of them") from error
    except Image.DecompressionBombError as error:
        raise FormatError(f"{name}: {error}; {max_photo_pixels:,} pixels are allowed") from error
    with image:
        if image.width * image.height > max_photo_pixels or min(image.size) < min_side_px:
            problem = f"{name} has {image.width} x {image.height} pixels"
            allowed = f"at least {min_side_px} a side and at most {max_photo_pixels:,} in all are allowed"
            raise FormatError(f"{problem}; {allowed}")
        yield image


def _focal_35mm(image: Image.Image) -> float | None:
    focal_range_mm = (8, 800)  # EXIF has 0 for unknown; some editors write other wrong values
    focal = image.getexif().get_ifd(_EXIF_IFD).get(_FOCAL_35MM)
    if isinstance(focal, int) and focal_range_mm[0] <= focal <= focal_range_mm[1]:
        return float(focal)
    return None


def read_photos(
    photos: Sequence[PhotoFile], root: Path | None, folder: Path, on_photo: OnPhoto
) -> tuple[Given, list[Photo]]:
    """Return the cameras that came with the photos, if any, and the photos that `prepare_photos` wrote to `folder`.

    Raises:
        InputError: see `find_input_cameras` and `prepare_photos`.
    """
    given = None
    if root is not None:
        sizes = {photo.name: sizes_of(photo) for photo in sorted(photos, key=lambda photo: photo.name)}
        given = find_input_cameras(root, sizes)
    if given is not None:  # a photo is not rotated if its camera fits the stored size: some programs ignore EXIF
        by_photo = {camera.photo: camera for camera in given}
        photos = [
            replace(photo, as_stored=fits(by_photo[photo.name], sizes[photo.name][0]))
            for photo in photos
            if photo.name in by_photo
        ]
    return given, prepare_photos(photos, folder, on_photo=on_photo)
