"""OpenEXR pictures of half floats: one scanline part, ZIP compression. OpenEXR's file layout document, version 2."""

import struct
import zlib

import numpy as np
from jaxtyping import Float16, UInt8

from dynamictree.byte_stream import ByteWriter


def write_exr(pixels: Float16[np.ndarray, "H W C"], stream: ByteWriter, *, channels: str = "RGB") -> None:
    """Write a linear picture, first row on top; a channel a letter, in the order of the last axis."""
    lines_at_once = 16  # lines that ZIP compresses together
    assert len(channels) == pixels.shape[2]
    height, width, _ = pixels.shape
    order = np.argsort(list(channels))  # a file lists its channels by name
    head = _header(width, height, "".join(sorted(channels)))
    lines = np.ascontiguousarray(pixels[:, :, order].transpose(0, 2, 1))  # [H, C, W]
    blocks = [_block(top, lines[top : top + lines_at_once]) for top in range(0, height, lines_at_once)]
    sizes = [0, *np.cumsum([len(block) for block in blocks[:-1]]).tolist()]
    first = len(head) + 8 * len(blocks)
    stream.write(head + struct.pack(f"<{len(blocks)}Q", *(first + size for size in sizes)))
    for block in blocks:
        stream.write(block)


def _header(width: int, height: int, channels: str) -> bytes:
    magic, version = 20000630, 2
    half, zip_lines, increasing = 1, 3, 0
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(name.encode() + struct.pack("<xiB3xii", half, 1, 1, 1) for name in channels)
    attributes = [
        ("channels", "chlist", listed + b"\0"),
        ("compression", "compression", bytes([zip_lines])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", bytes([increasing])),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]
    named = (f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value for name, kind, value in attributes)
    return struct.pack("<ii", magic, version) + b"".join(named) + b"\0"


def _block(top: int, lines: Float16[np.ndarray, "L C W"]) -> bytes:
    plain = lines.astype("<f2").tobytes()
    packed = zlib.compress(_predicted(np.frombuffer(plain, np.uint8)).tobytes())
    if len(packed) >= len(plain):
        packed = plain  # readers take a block of full size as not compressed
    return struct.pack("<ii", top, len(packed)) + packed


def _predicted(content: UInt8[np.ndarray, " n"]) -> UInt8[np.ndarray, " n"]:
    """Low bytes first, then high bytes, each as its difference from the byte before, plus 128."""
    apart = np.concatenate([content[0::2], content[1::2]])
    steps = apart.copy()
    steps[1:] = apart[1:] - apart[:-1] + np.uint8(128)
    return steps
