"""Photos, read by Pillow; HEIC needs pillow-heif (extra `photos`)."""

from importlib.util import find_spec
from pathlib import Path

from PIL import Image

from dynamictree.errors import FormatError

PHOTO_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "HEIF")
"""Names of formats in Pillow; HEIF is the HEIC of phones."""
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1")
"""Brands in `ftyp`, ISO/IEC 23008-12, annex B; iPhones write `heic`."""

if find_spec("pillow_heif") is not None:
    from pillow_heif import register_heif_opener

    # one picture per file, no thumbnails or depth; decoding in this thread, as a sandboxed process may start no other
    register_heif_opener(thumbnails=False, depth_images=False, aux_images=False, decode_threads=1)


def open_photo(path: Path, name: str) -> Image.Image:
    """Open a photo without decoding its pixels; `name` is for messages.

    Raises:
        FormatError: it is HEIC and the extra `photos` is not installed.
        PIL.UnidentifiedImageError: it is of none of `PHOTO_FORMATS`.
    """
    if is_heif(path) and "HEIF" not in Image.OPEN:
        raise FormatError(f"{name} is HEIC, which pillow-heif reads; install dynamictree[photos], or save it as JPEG")
    return Image.open(path, formats=[each for each in PHOTO_FORMATS if each != "HEIF" or each in Image.OPEN])


def is_heif(path: Path) -> bool:
    """Whether a file begins like a HEIC photo."""
    with path.open("rb") as stream:
        head = stream.read(12)
    return head[4:8] == b"ftyp" and head[8:] in _HEIF_BRANDS
