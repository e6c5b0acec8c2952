"""Remove the location where a photo was taken. Exif 2.32 section 4.6.6; XMP part 3, 1.1.3.

The bytes are zeroed in place, so the length, pixels, orientation and focal length stay as they are.
"""

import re
import struct
import zlib
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256

from dynamictree.formats.photo import is_heif
from service.http.multipart import ReceivedFile
from service.http.problems import ProblemError

_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/"
_APP1, _APP13 = 0xE1, 0xED  # segments with EXIF and XMP; with IPTC, which may name a town
_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]", re.DOTALL)  # excludes what occurs within the coded picture
_BARE, _END = (0x01, 0xD8), 0xD9  # markers without a length
_GPS = 0x8825
_TIFF_TEXT = frozenset({700, 33723, 34377})  # XMP, IPTC, Photoshop's
_EXIF_CHUNKS = (b"eXIf", b"EXIF")
_TEXT_CHUNKS = (b"XMP ", b"iTXt", b"tEXt", b"zTXt")
_PLACE_TEXT = re.compile(rb"XML:com\.adobe\.xmp\0|Raw profile type ", re.DOTALL)
_TIFF_HEAD = re.compile(rb"II\*\0|MM\0\*")
_XMP_PACKET = re.compile(rb"<x:xmpmeta.*?</x:xmpmeta>", re.DOTALL)
MAX_EXIF_BYTES = 2**20
"""Size of the EXIF in a HEIC file: sixteen times what a JPEG can contain."""
MAX_CHUNKS, MAX_PAGES = 10_000, 1_000
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}  # bytes of a TIFF type


def without_location(file: ReceivedFile) -> ReceivedFile:
    """Remove the location from a photo in JPEG, PNG, WebP, TIFF or HEIC; refuse BigTIFF."""
    content = bytearray(file.path.read_bytes())
    before = bytes(content)
    if before.startswith(b"\xff\xd8"):
        _blank_jpeg(content)
    elif before.startswith(b"\x89PNG\r\n\x1a\n"):
        _blank_chunks(content, at=8, is_png=True)
    elif before.startswith(b"RIFF") and before[8:12] == b"WEBP":
        _blank_chunks(content, at=12, is_png=False)
    elif _TIFF_HEAD.match(before):
        tiff = bytearray(content)
        with suppress(struct.error, KeyError):  # no decoder can read it either
            _blank_gps(tiff, also=_TIFF_TEXT)
            content = tiff
    elif is_heif(file.path):
        _blank_heif(content)
    elif before[:4] in (b"II+\0", b"MM\0+"):
        raise ProblemError("unsupported-format", f"photo {file.name!r} is a BigTIFF; save it as TIFF, JPEG or PNG")
    if content == before:
        return file
    file.path.write_bytes(content)
    return replace(file, sha256=sha256(content).hexdigest())


def _blank_jpeg(content: bytearray) -> None:
    """Blank EXIF, XMP and IPTC anywhere in the file, and all that follows the picture: other pictures, films, notes."""
    at = 2
    while marker := _MARKER.search(content, at):
        at, kind = marker.end(), content[marker.end() - 1]
        if kind == _END:
            content[at:] = bytes(len(content) - at)
            return
        if kind in _BARE:
            continue
        end = at + max(int.from_bytes(content[at : at + 2], "big"), 2)
        if kind in (_APP1, _APP13):
            content[at + 2 : end] = _blanked(kind, bytes(content[at + 2 : end]))
        at = end


def _blank_chunks(content: bytearray, *, at: int, is_png: bool) -> None:
    """Blank EXIF, XMP and text in the chunks of a PNG (length, name, data, CRC) or a WebP (name, length, data)."""
    for _ in range(MAX_CHUNKS):
        first, second, at = bytes(content[at : at + 4]), bytes(content[at + 4 : at + 8]), at + 8
        name, length = (second, int.from_bytes(first, "big")) if is_png else (first, int.from_bytes(second, "little"))
        if at > len(content):
            return
        chunk = bytes(content[at : at + length]) if name in _EXIF_CHUNKS or name in _TEXT_CHUNKS else b""
        blank = _blanked_chunk(name, chunk)
        if blank != chunk:
            content[at : at + len(blank)] = blank
            if is_png:
                content[at + length : at + length + 4] = zlib.crc32(blank, zlib.crc32(name)).to_bytes(4, "big")
        at += length + (4 if is_png else length % 2)


def _blanked_chunk(name: bytes, content: bytes) -> bytes:
    if name in _EXIF_CHUNKS:
        skipped = len(_EXIF) if content.startswith(_EXIF) else 0
        return content[:skipped] + _blanked(_APP1, _EXIF + content[skipped:])[len(_EXIF) :]
    if name in _TEXT_CHUNKS and (name == b"XMP " or _PLACE_TEXT.match(content)):
        keyword = content.partition(b"\0")[0] + b"\0" if name != b"XMP " else b""
        return keyword + bytes(len(content) - len(keyword))
    return content


def _blank_heif(content: bytearray) -> None:
    """Blank the GPS data of EXIF, which a HEIC file stores as a TIFF, and XMP, anywhere in the file."""
    before = bytes(content)
    for match in _TIFF_HEAD.finditer(before):
        tiff = bytearray(before[match.start() : match.start() + MAX_EXIF_BYTES])
        with suppress(struct.error, KeyError):  # no EXIF but bytes of the coded picture
            _blank_gps(tiff)
            content[match.start() : match.start() + len(tiff)] = tiff
    for match in _XMP_PACKET.finditer(before):
        _zero(content, match.start(), match.end() - match.start())


def _blanked(marker: int, content: bytes) -> bytes:
    if marker == _APP13 or content.startswith(_XMP):
        return bytes(len(content))
    if not content.startswith(_EXIF):
        return content
    tiff = bytearray(content[len(_EXIF) :])
    try:
        _blank_gps(tiff)
    except (struct.error, KeyError):
        return bytes(len(content))  # unreadable metadata may contain a location
    return _EXIF + bytes(tiff)


def _blank_gps(tiff: bytearray, also: frozenset[int] = frozenset()) -> None:
    """Empty the GPS directories of all pages, and zero their values and those of the tags `also`.

    Raises:
        struct.error: an offset points outside of the content.
        KeyError: a byte order or a type is unknown.
    """
    order = {b"II": "<", b"MM": ">"}[bytes(tiff[:2])]
    (directory,) = struct.unpack_from(f"{order}I", tiff, 4)
    seen = set[int]()
    while directory and directory not in seen and len(seen) < MAX_PAGES:
        seen.add(directory)
        (count,) = struct.unpack_from(f"{order}H", tiff, directory)
        end = directory + 2 + 12 * count
        for entry in range(directory + 2, end, 12):
            tag, kind, number, place = struct.unpack_from(f"{order}HHII", tiff, entry)
            if tag in also and (size := _SIZES[kind] * number) > 4:
                _zero(tiff, place, size)
            if tag == _GPS:
                _blank_gps_directory(tiff, order, place)
        directory = struct.unpack_from(f"{order}I", tiff, end)[0] if end + 4 <= len(tiff) else 0


def _blank_gps_directory(tiff: bytearray, order: str, place: int) -> None:
    (count,) = struct.unpack_from(f"{order}H", tiff, place)
    for field in range(place + 2, place + 2 + 12 * count, 12):
        _, kind, number, value = struct.unpack_from(f"{order}HHII", tiff, field)
        if (size := _SIZES[kind] * number) > 4:
            _zero(tiff, value, size)
        tiff[field : field + 12] = bytes(12)
    struct.pack_into(f"{order}H", tiff, place, 0)


def _zero(tiff: bytearray, at: int, size: int) -> None:
    tiff[at : at + size] = bytes(max(min(at + size, len(tiff)) - at, 0))
