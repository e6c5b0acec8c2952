"""Textures of mesh files: decoded once under a size limit, stored as PNG."""

import io
import math
import struct
import warnings
from collections.abc import Iterable

import numpy as np
from PIL import Image, UnidentifiedImageError

from dynamictree.errors import FormatError

MAX_PIXELS = 50_000_000
MAX_TOTAL_PIXELS = 400_000_000
"""Limit for all images of one file together: about 24 of 4096 x 4096."""

_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF", "DDS")


def refuse_many_pixels(images: Iterable[bytes]) -> None:
    """Check the number of pixels that all images of a file, each once as PNG, have together, before they are decoded.

    Raises:
        FormatError: they have more than `MAX_TOTAL_PIXELS` together.
    """
    total = sum(math.prod(struct.unpack_from(">II", png, 16)) for png in images)  # the header's width and height
    if total > MAX_TOTAL_PIXELS:
        raise FormatError(f"the textures have {total:,} pixels; at most {MAX_TOTAL_PIXELS:,} are allowed; reduce them")


def texture_as_png(content: bytes, name: str) -> bytes:
    """Convert an image to PNG; a valid PNG is returned unchanged.

    Raises:
        FormatError: no image of a known format, damaged, or of more than `MAX_PIXELS`.
    """
    image = decoded_image(content, f"texture {name!r}", formats=_FORMATS)
    if image.format == "PNG" and image.mode in ("RGB", "RGBA", "L", "LA", "P"):
        return content
    image = in_eight_bits(image)
    stream = io.BytesIO()
    image.convert("RGBA" if "A" in image.getbands() else "RGB").save(stream, "PNG")
    return stream.getvalue()


def decoded_image(
    content: bytes, what: str, *, formats: tuple[str, ...], most_pixels: int | None = None
) -> Image.Image:
    """Decode an image after its size is checked; `what` names it in messages.

    Raises:
        FormatError: no image of the formats, damaged, or of more pixels than allowed (`MAX_PIXELS` by default).
    """
    allowed = MAX_PIXELS if most_pixels is None else most_pixels
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked below
            image: Image.Image = Image.open(io.BytesIO(content), formats=formats)
        width, height = image.size
        if width * height > allowed:
            raise FormatError(f"{what} has {width} x {height} pixels; at most {allowed:,} are allowed")
        image.load()
    except (UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise FormatError(f"{what} is no image of {', '.join(formats)}; convert it") from error
    except (OSError, SyntaxError, ValueError, EOFError, IndexError, TypeError) as error:  # raised by Pillow's decoders
        raise FormatError(f"{what} is damaged: {str(error)[:120]}") from error
    return image


def in_eight_bits(image: Image.Image) -> Image.Image:
    """Scale a grey image of 16 bits or floats to 8 bits, which Pillow would clip; return others unchanged."""
    largest = {"I": 65_535.0, "F": 1.0}  # white of grey images with more than eight bits, by the mode's first letter
    if image.mode[0] not in largest:
        return image
    share = np.asarray(image, np.float64) / largest[image.mode[0]]
    return Image.fromarray(np.round(np.nan_to_num(share).clip(0, 1) * 255).astype(np.uint8))
