"""Remove the place where a photo was taken, in place. Exif 2.32 section 4.6.6; XMP part 3, 1.1.3.

In place and of the same length: pixels, orientation and focal length stay as they are.
"""

import re
import struct
import zlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from dynamictree.formats.photo import is_heif
from jobs.storage.artifacts import hash_file
from service.http.multipart import ReceivedFile
from service.http.problems import ProblemError

_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/"
_APP1, _APP13 = 0xE1, 0xED  # EXIF and XMP; IPTC, which names towns
_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]", re.DOTALL)  # in the coded picture there is no other
_BARE, _END = (0x01, 0xD8), 0xD9  # markers without a length
_GPS = 0x8825
_TIFF_TEXT = frozenset({700, 33723, 34377})  # XMP, IPTC, Photoshop's
_EXIF_CHUNKS = (b"eXIf", b"EXIF")
_TEXT_CHUNKS = (b"XMP ", b"iTXt", b"tEXt", b"zTXt")
_PLACE_TEXT = re.compile(rb"XML:com\.adobe\.xmp\0|Raw profile type ", re.DOTALL)
_TIFF_HEAD = re.compile(rb"II\*\0|MM\0\*")
_XMP_PACKET = re.compile(rb"<x:xmpmeta.*?</x:xmpmeta>", re.DOTALL)
MAX_EXIF_BYTES = 2**20
"""Of the EXIF of a HEIC file: sixteen times what a JPEG can hold."""
MAX_CHUNKS, MAX_PAGES = 10_000, 1_000
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}  # bytes of a TIFF type


def without_place(file: ReceivedFile) -> ReceivedFile:
    """The same photo without the place where it was taken, in JPEG, PNG, WebP, TIFF and HEIC.

    Raises:
        ProblemError: it is a BigTIFF, whose directories have another form.
    """
    with file.path.open("rb") as stream:
        head = stream.read(12)
    if head.startswith(b"\xff\xd8"):
        changed = _blank_jpeg(file.path)
    elif head.startswith(b"\x89PNG\r\n\x1a\n"):
        changed = _blank_chunks(file.path, start=8, is_png=True)
    elif head.startswith(b"RIFF") and head.endswith(b"WEBP"):
        changed = _blank_chunks(file.path, start=12, is_png=False)
    elif head[:4] in (b"II*\0", b"MM\0*"):
        changed = _blank_tiff_file(file.path)
    elif is_heif(file.path):
        changed = _blank_heif(file.path)
    elif head[:4] in (b"II+\0", b"MM\0+"):
        raise ProblemError("unsupported-format", f"photo {file.name!r} is a BigTIFF; save it as TIFF, JPEG or PNG")
    else:
        changed = False
    if not changed:
        return file
    digest, _ = hash_file(file.path)
    return replace(file, sha256=digest)


def _blank_jpeg(path: Path) -> bool:
    """Blank EXIF, XMP and IPTC wherever they stand, and what follows the picture: other pictures, films, notes."""
    content = bytearray(path.read_bytes())
    before = bytes(content)
    at = 2
    while marker := _MARKER.search(content, at):
        at, kind = marker.end(), content[marker.end() - 1]
        if kind == _END:
            content[at:] = bytes(len(content) - at)
            break
        if kind in _BARE:
            continue
        end = at + max(int.from_bytes(content[at : at + 2], "big"), 2)
        if kind in (_APP1, _APP13):
            content[at + 2 : end] = _blanked(kind, bytes(content[at + 2 : end]))
        at = end
    if content == before:
        return False
    path.write_bytes(content)
    return True


def _blank_chunks(path: Path, *, start: int, is_png: bool) -> bool:
    """Blank EXIF, XMP and text in the chunks of a PNG (length, name, data, CRC) or a WebP (name, length, data)."""
    changed = False
    with path.open("r+b") as stream:
        stream.seek(start)
        for _ in range(MAX_CHUNKS):
            head = stream.read(8)
            if len(head) < 8:
                break
            name = head[4:] if is_png else head[:4]
            length = int.from_bytes(head[:4], "big") if is_png else int.from_bytes(head[4:], "little")
            at = stream.tell()
            content = stream.read(length) if name in _EXIF_CHUNKS or name in _TEXT_CHUNKS else b""
            blank = _blanked_chunk(name, content)
            if blank != content:
                stream.seek(at)
                stream.write(blank)
                if is_png:
                    stream.write(zlib.crc32(blank, zlib.crc32(name)).to_bytes(4, "big"))
                changed = True
            stream.seek(at + length + (4 if is_png else length % 2))
    return changed


def _blanked_chunk(name: bytes, content: bytes) -> bytes:
    if name in _EXIF_CHUNKS:
        skipped = len(_EXIF) if content.startswith(_EXIF) else 0
        return content[:skipped] + _blanked(_APP1, _EXIF + content[skipped:])[len(_EXIF) :]
    if name in _TEXT_CHUNKS and (name == b"XMP " or _PLACE_TEXT.match(content)):
        keyword = content.partition(b"\0")[0] + b"\0" if name != b"XMP " else b""
        return keyword + bytes(len(content) - len(keyword))
    return content


def _blank_heif(path: Path) -> bool:
    """Blank the GPS of EXIF, which lies in a HEIC file as a TIFF does, and XMP; wherever they stand."""
    content = bytearray(path.read_bytes())
    before = bytes(content)
    for match in _TIFF_HEAD.finditer(before):
        tiff = bytearray(before[match.start() : match.start() + MAX_EXIF_BYTES])
        with suppress(struct.error, KeyError):  # these bytes are of the coded picture
            _blank_gps(tiff)
            content[match.start() : match.start() + len(tiff)] = tiff
    for match in _XMP_PACKET.finditer(before):
        _zero(content, match.start(), match.end() - match.start())
    if content == before:
        return False
    path.write_bytes(content)
    return True


def _blank_tiff_file(path: Path) -> bool:
    content = path.read_bytes()
    tiff = bytearray(content)
    try:
        _blank_gps(tiff, also=_TIFF_TEXT)
    except (struct.error, KeyError):
        return False  # no decoder reads it either
    if tiff == content:
        return False
    path.write_bytes(tiff)
    return True


def _blanked(marker: int, content: bytes) -> bytes:
    if marker == _APP13 or content.startswith(_XMP):
        return bytes(len(content))
    if not content.startswith(_EXIF):
        return content
    tiff = bytearray(content[len(_EXIF) :])
    try:
        _blank_gps(tiff)
    except (struct.error, KeyError):
        return bytes(len(content))  # what cannot be read may tell a place
    return _EXIF + bytes(tiff)


def _blank_gps(tiff: bytearray, also: frozenset[int] = frozenset()) -> None:
    """Empty the directories of GPS of all pages, and zero what they point to, and the values of the tags `also`.

    Raises:
        struct.error: an offset that leads outside.
        KeyError: a byte order or a type that there is not.
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
