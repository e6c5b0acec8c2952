"""Where a photo was taken, blanked in its bytes before they are kept. Exif 2.32 section 4.6.6; XMP part 3, 1.1.3.

In place and of the same length: pixels, orientation and focal length stay as they are.
"""

import struct
from dataclasses import replace
from pathlib import Path

from jobs.artifacts import hash_file
from service.http.multipart import ReceivedFile

MAX_SEGMENTS = 200
_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/"
_APP1, _APP13, _SCAN = 0xE1, 0xED, 0xDA  # EXIF and XMP; IPTC, which names towns; where the picture begins
_GPS = 0x8825
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}  # bytes of a TIFF type


def without_place(file: ReceivedFile) -> ReceivedFile:
    """The same photo; if it is a JPEG that tells where it was taken, it does so no more."""
    if not _blank_jpeg(file.path):
        return file
    digest, _ = hash_file(file.path)
    return replace(file, sha256=digest)


def _blank_jpeg(path: Path) -> bool:
    changed = False
    with path.open("r+b") as stream:
        if stream.read(2) != b"\xff\xd8":
            return False
        for _ in range(MAX_SEGMENTS):
            head = stream.read(4)
            if len(head) < 4 or head[0] != 0xFF or head[1] == _SCAN:
                break
            length = int.from_bytes(head[2:], "big") - 2
            start = stream.tell()
            content = stream.read(max(length, 0)) if head[1] in (_APP1, _APP13) else b""
            blank = _blanked(head[1], content)
            if blank != content:
                stream.seek(start)
                stream.write(blank)
                changed = True
            stream.seek(start + max(length, 0))
    return changed


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


def _blank_gps(tiff: bytearray) -> None:
    """Empty the directory of GPS, and zero what it had pointed to.

    Raises:
        struct.error: an offset that leads outside.
        KeyError: a byte order or a type that there is not.
    """
    order = {b"II": "<", b"MM": ">"}[bytes(tiff[:2])]
    (first,) = struct.unpack_from(f"{order}I", tiff, 4)
    (count,) = struct.unpack_from(f"{order}H", tiff, first)
    for entry in range(first + 2, first + 2 + 12 * count, 12):
        tag, _, _, place = struct.unpack_from(f"{order}HHII", tiff, entry)
        if tag != _GPS:
            continue
        (inside,) = struct.unpack_from(f"{order}H", tiff, place)
        for field in range(place + 2, place + 2 + 12 * inside, 12):
            _, kind, number, value = struct.unpack_from(f"{order}HHII", tiff, field)
            size = _SIZES[kind] * number
            if size > 4:
                tiff[value : value + size] = bytes(max(min(value + size, len(tiff)) - value, 0))
            tiff[field : field + 12] = bytes(12)
        struct.pack_into(f"{order}H", tiff, place, 0)
