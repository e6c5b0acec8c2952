"""Photos as they come from a camera: checked, turned upright, reduced, and freed of what they tell about the place."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageOps, UnidentifiedImageError

from dynamictree.errors import FormatError, InputError

MIN_PHOTOS, MAX_PHOTOS = 8, 300
MAX_PHOTO_BYTES = 64 * 2**20
MAX_PHOTO_PIXELS = 64_000_000  # the largest common camera's; decoding takes 200 MB
MIN_SIDE_PX = 240
LONG_SIDE_PX = 1200  # to which photos are reduced: two cores match a pair in a fraction of a second

_EXIF_IFD, _FOCAL_35MM = 0x8769, 0xA405
_FILM_WIDTH_MM = 36.0
_FOCAL_RANGE_MM = (8, 800)  # EXIF says 0 for unknown, and anything after some editors


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A photo ready for matching."""

    source: str  # the file's name as given
    name: str  # of the prepared file, below its folder
    width: int
    height: int
    focal_px: float | None  # as EXIF tells it, or None


def prepare_photos(
    paths: Sequence[Path], folder: Path, *, on_photo: Callable[[int, int], None] = lambda done, total: None
) -> list[Photo]:
    """Write an upright, reduced JPEG of each photo, without EXIF and so without GPS; order as given.

    Raises:
        InputError: too few or too many photos.
        FormatError: a file that is no JPEG or PNG, is truncated, too large or too small.
    """
    if not MIN_PHOTOS <= len(paths) <= MAX_PHOTOS:
        advice = "walk around the tree and take one every 10 to 20 degrees"
        raise InputError(f"{len(paths)} photos were given; {MIN_PHOTOS} to {MAX_PHOTOS} are needed; {advice}")
    folder.mkdir(parents=True, exist_ok=True)
    photos = []
    for number, path in enumerate(paths):
        on_photo(number, len(paths))
        photos.append(_prepare(path, folder, f"{number:04d}.jpg"))
    on_photo(len(paths), len(paths))
    return photos


def _prepare(path: Path, folder: Path, name: str) -> Photo:
    size = path.stat().st_size
    if size > MAX_PHOTO_BYTES:
        raise FormatError(f"{path.name} has {size:,} bytes; a photo may have {MAX_PHOTO_BYTES:,}; reduce it")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own cap, below, is tighter
            image = Image.open(path, formats=("JPEG", "PNG"))
    except UnidentifiedImageError as error:
        raise FormatError(f"{path.name} is neither JPEG nor PNG; convert it to one of them") from error
    except Image.DecompressionBombError as error:
        raise FormatError(f"{path.name}: {error}; {MAX_PHOTO_PIXELS:,} pixels are allowed") from error
    with image:
        if image.width * image.height > MAX_PHOTO_PIXELS or min(image.size) < MIN_SIDE_PX:
            found = f"{path.name} has {image.width} x {image.height} pixels"
            allowed = f"at least {MIN_SIDE_PX} a side and at most {MAX_PHOTO_PIXELS:,} in all are allowed"
            raise FormatError(f"{found}; {allowed}")
        focal_35mm = _focal_35mm(image)
        image.draft("RGB", (LONG_SIDE_PX, LONG_SIDE_PX))  # a JPEG is decoded at the next larger of 1/2, 1/4, 1/8
        try:
            upright = ImageOps.exif_transpose(image).convert("RGB")
        except (OSError, SyntaxError) as error:
            raise FormatError(f"{path.name} cannot be decoded: {error}; copy it from the camera again") from error
    if max(upright.size) > LONG_SIDE_PX:
        upright.thumbnail((LONG_SIDE_PX, LONG_SIDE_PX), Image.Resampling.LANCZOS)
    upright.save(folder / name, format="JPEG", quality=95, subsampling=0, exif=b"")
    focal_px = None if focal_35mm is None else focal_35mm / _FILM_WIDTH_MM * max(upright.size)
    return Photo(source=path.name, name=name, width=upright.width, height=upright.height, focal_px=focal_px)


def _focal_35mm(image: Image.Image) -> float | None:
    focal = image.getexif().get_ifd(_EXIF_IFD).get(_FOCAL_35MM)
    if isinstance(focal, int) and _FOCAL_RANGE_MM[0] <= focal <= _FOCAL_RANGE_MM[1]:
        return float(focal)
    return None
