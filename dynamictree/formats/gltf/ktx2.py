"""KTX 2 textures with a Basis Universal payload, the only one that glTF's KHR_texture_basisu allows, as PNG."""

import io
import struct

from PIL import Image

from dynamictree.errors import FormatError
from dynamictree.formats.texture import MAX_PIXELS

_SIZE = struct.Struct("<II")


def has_ktx2() -> bool:
    """Whether the transcoder is installed."""
    try:
        import opengl_basisu  # noqa: F401
    except ImportError:
        return False
    return True


def ktx2_as_png(content: bytes, name: str) -> bytes:
    """Convert the largest level of a texture to PNG.

    Raises:
        FormatError: no Basis Universal texture, damaged, or of more than `MAX_PIXELS`.
    """
    size_at = 20  # offset after the identifier, the format and the type's size
    import opengl_basisu

    if len(content) >= size_at + _SIZE.size:
        width, height = _SIZE.unpack_from(content, size_at)
        if width * height > MAX_PIXELS:
            raise FormatError(f"texture {name!r} has {width} x {height} pixels; at most {MAX_PIXELS:,} are allowed")
    try:
        texture = opengl_basisu.open(content)
        pixels = texture.transcode("rgba8", level=0).data
    except (opengl_basisu.BasisuError, ValueError) as error:
        raise FormatError(f"texture {name!r} cannot be transcoded from KTX 2: {str(error)[:120]}") from error
    image = Image.fromarray(pixels, "RGBA")
    stream = io.BytesIO()
    (image if texture.has_alpha else image.convert("RGB")).save(stream, "PNG")
    return stream.getvalue()
