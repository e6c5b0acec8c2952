"""SOG files of PlayCanvas, version 2: lossless WebP images with one pixel per Gaussian, and `meta.json`, in a ZIP.

Positions are 16-bit steps of sign(x) ln(1 + |x|). Logarithms of scales and harmonics of degree 0 are bytes that index a
codebook of 256 numbers. Higher harmonics are 16-bit indices of a palette, whose rows are such bytes.
"""

import io
import json
import zipfile
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32, Shaped, UInt8
from PIL import Image

from dynamictree.byte_stream import ByteWriter, read_all
from dynamictree.errors import FormatError
from dynamictree.formats.companions import find_companion
from dynamictree.formats.json_fields import (
    JsonObject,
    integer_field,
    numbers_field,
    object_field,
    parse_object,
    text_list,
)
from dynamictree.formats.seekable import SeekableReader, refuse_bomb, remaining_bytes
from dynamictree.formats.splat.activations import drop_largest, log_from_scales, restore_largest, scales_from_log
from dynamictree.formats.splat.codebook import CODES, codes_of, palette_of
from dynamictree.formats.suffixes import SOG_FOLDER_FILE
from dynamictree.formats.texture import decoded_image
from dynamictree.gaussian.axes import to_source_axes
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.rotation import unit_quaternions
from dynamictree.voxel.grid import morton_order

META = SOG_FOLDER_FILE
UP_AXIS = "-Y"
"""The same as in a PLY file of the scene."""
_VERSION = 2
_PARTS = ("means", "scales", "quats", "sh0", "shN")
_MAX_META_BYTES = 1 << 20
_MAX_FILES = 64
_ROW = 64  # palette entries per row of the image
_MAX_PALETTE = 1 << 16
_STEPS = 65_535
_FIRST_TAG = 252  # alpha of a rotation: this plus the index of the largest of w, x, y, z
_UNREADABLE = (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError, OSError, EOFError)


def read_sog(stream: SeekableReader) -> GaussianCloud:
    """Read a SOG bundle.

    Raises:
        FormatError: not a ZIP with SOG version 2, images that are missing or do not fit, or damaged.
        InputError: too many Gaussians.
    """
    files = _unpacked(stream)
    meta = parse_object(files.get(META, b""), META)
    if meta.get("version") != _VERSION:
        raise FormatError(
            f"the SOG file is of version {str(meta.get('version', 1))[:20]}; {_VERSION} is understood: "
            "convert it with `splat-transform old.sog new.sog`"
        )
    count = integer_field(meta, "count", high=1 << 32)
    check_count(count)
    refuse_bomb(f"the SOG file of {count:,} Gaussians", 20 * count, sum(map(len, files.values())))  # five pictures
    low, high = (_picture(files, meta, "means", count, place) for place in (0, 1))
    rotations, scales, colors = (_picture(files, meta, name, count) for name in ("quats", "scales", "sh0"))
    first = _codebook(meta, "sh0")[colors[:, :3]]  # [G, 3]
    return GaussianCloud(
        means=_means(object_field(meta, "means"), low, high),
        quaternions=unit_quaternions(_rotations(rotations)),
        scales=scales_from_log(_codebook(meta, "scales")[scales[:, :3]]),
        opacity=colors[:, 3] / np.float32(255),
        sh=np.concatenate([first[:, None], _harmonics(files, meta, count)], axis=1),
    )


def is_folder_file(stream: SeekableReader) -> bool:
    """Whether a stream is `meta.json` and no bundle; it is left at its start."""
    head = stream.read(1)
    stream.seek(0)
    return head == b"{"


def bundled(meta: SeekableReader, beside: Mapping[str, bytes]) -> SeekableReader:
    """Bundle the files of a SOG folder; `read_sog` reports missing images.

    Raises:
        FormatError: `meta.json` is too large, or no JSON.
    """
    content = read_all(meta, _MAX_META_BYTES)
    described = parse_object(content, META)
    pictures = [name for part in _PARTS for name in text_list(object_field(described, part), "files")]
    parts = {name: find_companion(name, beside) for name in pictures[:_MAX_FILES]}
    files = {META: content} | {name: part for name, part in parts.items() if part is not None}
    return io.BytesIO(_zipped(files))


def write_sog(cloud: GaussianCloud, stream: ByteWriter) -> None:
    """Write a bundle in the source's units and −Y up, in Morton order; harmonics lose the most precision."""
    source = to_source_axes(cloud, UP_AXIS)
    log_places = np.sign(source.means) * np.log1p(np.abs(source.means.astype(np.float64)))
    low, high = log_places.min(axis=0), log_places.max(axis=0)
    steps = np.rint((log_places - low) / np.maximum(high - low, 1e-30) * _STEPS).astype(np.int64)
    order = morton_order(steps)  # neighbours in space are neighbours in the images, which then compress better
    source, steps = source.subset(order), steps[order]
    scale_codes, scale_book = codes_of(log_from_scales(source.scales))
    color_codes, color_book = codes_of(source.sh[:, 0])
    opacity = np.rint(source.opacity[:, None] * 255).astype(np.uint8)
    others, largest = drop_largest(source.quaternions)
    packed = np.clip(np.rint((others * np.sqrt(2) + 1) * 127.5), 0, 255)
    pictures = {
        "means_l": _opaque(steps & 255),
        "means_u": _opaque(steps >> 8),
        "scales": _opaque(scale_codes),
        "quats": np.concatenate([packed, _FIRST_TAG + largest[:, None]], axis=1).astype(np.uint8),
        "sh0": np.concatenate([color_codes, opacity], axis=1),
    }
    meta: dict[str, object] = {
        "version": _VERSION,
        "count": source.num_gaussians,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_book.tolist(), "files": ["sh0.webp"]},
    }
    files = {f"{name}.webp": _webp(pixels, _width(len(pixels))) for name, pixels in pictures.items()}
    if source.sh_degree:
        meta["shN"] = _write_harmonics(source, files)
    files = {META: json.dumps(meta).encode()} | files
    stream.write(_zipped(files))


def _zipped(files: Mapping[str, bytes]) -> bytes:
    """Return an uncompressed archive without dates or zip64 records, which PlayCanvas' readers do not support."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, part in files.items():
            archive.writestr(zipfile.ZipInfo(name), part)
    return content.getvalue()


def _unpacked(stream: SeekableReader) -> dict[str, bytes]:
    """Read all files of the archive, by name."""
    size = remaining_bytes(stream)
    try:
        with zipfile.ZipFile(io.BytesIO(stream.read())) as archive:
            entries = archive.infolist()
            if len(entries) > _MAX_FILES:
                raise FormatError(f"the SOG archive has {len(entries):,} files; at most {_MAX_FILES} files are allowed")
            refuse_bomb("the SOG archive", sum(entry.file_size for entry in entries), size)
            if any(entry.filename == META and entry.file_size > _MAX_META_BYTES for entry in entries):
                raise FormatError(
                    f"{META} of the SOG file is larger than the {_MAX_META_BYTES:,} bytes that are allowed"
                )
            return {entry.filename: archive.read(entry) for entry in entries}
    except (*_UNREADABLE, ValueError) as error:
        raise FormatError(f"the SOG file is no ZIP archive that can be read: {str(error)[:120]}") from error


def _picture(
    files: Mapping[str, bytes], meta: JsonObject, name: str, count: int, place: int = 0
) -> UInt8[np.ndarray, "G 4"]:
    """Return the RGBA of the first `count` pixels of an image that `meta` names."""
    return _pixels(files, meta, name, place, count).reshape(-1, 4)[:count]


def _pixels(
    files: Mapping[str, bytes], meta: JsonObject, name: str, place: int, count: int
) -> UInt8[np.ndarray, "H W 4"]:
    """Return all pixels of an image, which must have at least `count` and not many more."""
    spare_pixels = 1 << 16  # pixels beyond one per Gaussian, which complete the last rows
    names = text_list(object_field(meta, name), "files")
    if place >= len(names) or names[place] not in files:
        raise FormatError(f"the SOG file lacks picture {place + 1} of {name}: {META} names {', '.join(names)[:80]!r}")
    what = f"picture {names[place][:40]!r} of the SOG file"
    image = decoded_image(files[names[place]], what, formats=("WEBP",), most_pixels=count + spare_pixels)
    if image.width * image.height < count:
        raise FormatError(f"{what} has {image.width} x {image.height} pixels; {count:,} are needed")
    return np.asarray(image.convert("RGBA"))


def _codebook(meta: JsonObject, name: str) -> Float32[np.ndarray, " 256"]:
    largest = 1e30  # limit of a codebook's numbers; larger ones overflow
    numbers = np.array(numbers_field(object_field(meta, name), "codebook", CODES, []), np.float64)
    return np.clip(numbers, -largest, largest).astype(np.float32)


def _means(
    bounds: JsonObject, low: UInt8[np.ndarray, "G 4"], high: UInt8[np.ndarray, "G 4"]
) -> Float32[np.ndarray, "G 3"]:
    far = 80.0  # larger exponents overflow float32, and are refused as not finite
    least, most = (np.array(numbers_field(bounds, name, 3, [])) for name in ("mins", "maxs"))
    steps = low[:, :3] + 256.0 * high[:, :3]
    logs = least + (most - least) * (steps / _STEPS)
    logs = np.where(np.abs(logs) > far, np.inf, logs)
    return (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32)


def _rotations(pixels: UInt8[np.ndarray, "G 4"]) -> Float32[np.ndarray, "G 4"]:
    """Unpack quaternions: bytes are the smaller components times √2, alpha names the largest; untagged are identity."""
    others = (pixels[:, :3] / np.float32(127.5) - 1) / np.float32(np.sqrt(2))
    tagged = pixels[:, 3] >= _FIRST_TAG
    largest = np.where(tagged, pixels[:, 3], _FIRST_TAG).astype(np.intp) - _FIRST_TAG
    return restore_largest(np.where(tagged[:, None], others, np.float32(0)), largest)


def _harmonics(files: Mapping[str, bytes], meta: JsonObject, count: int) -> Float32[np.ndarray, "G D 3"]:
    """Read the harmonics above degree 0."""
    described = object_field(meta, "shN")
    degree = integer_field(described, "bands", high=3, default=0)
    if degree == 0:
        return np.empty((count, 0, 3), np.float32)
    width = (degree + 1) ** 2 - 1
    entries = integer_field(described, "count", high=_MAX_PALETTE)
    rows = -(-entries // _ROW)
    pixels = _pixels(files, meta, "shN", 0, rows * _ROW * width)
    if pixels.shape[1] != _ROW * width or pixels.shape[0] < rows:
        raise FormatError(
            f"the SOG palette is {pixels.shape[1]} x {pixels.shape[0]}; {_ROW * width} x {rows} are needed for "
            f"{entries:,} entries of degree {degree}"
        )
    palette = _codebook(meta, "shN")[pixels[:rows, :, :3].reshape(-1, width, 3)]
    labels = _picture(files, meta, "shN", count, 1).astype(np.int64)
    chosen = labels[:, 0] + 256 * labels[:, 1]
    if chosen.max() >= entries:
        raise FormatError(f"a Gaussian of the SOG file names palette entry {chosen.max():,} of {entries:,}")
    chosen_rows: Float32[np.ndarray, "G D 3"] = palette[chosen]
    return chosen_rows


def _write_harmonics(cloud: GaussianCloud, files: dict[str, bytes]) -> dict[str, object]:
    """Add the images of the harmonics above degree 0 to `files`; return their entry in `meta.json`."""
    width = cloud.sh.shape[1] - 1
    palette, labels = palette_of(cloud.sh[:, 1:].reshape(cloud.num_gaussians, -1), _MAX_PALETTE)
    codes, book = codes_of(palette)
    padded = np.zeros((-(-len(codes) // _ROW) * _ROW, width, 3), np.uint8)
    padded[: len(codes)] = codes.reshape(-1, width, 3)
    pictures = {
        "shN_centroids.webp": (_opaque(padded.reshape(-1, 3)), _ROW * width),
        "shN_labels.webp": (
            _opaque(np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1)),
            _width(len(labels)),
        ),
    }
    files |= {name: _webp(pixels, columns) for name, (pixels, columns) in pictures.items()}
    return {"count": len(codes), "bands": cloud.sh_degree, "codebook": book.tolist(), "files": list(pictures)}


def _opaque(channels: Shaped[np.ndarray, "P 3"]) -> UInt8[np.ndarray, "P 4"]:
    return np.concatenate([channels, np.full((len(channels), 1), 255)], axis=1).astype(np.uint8)


def _width(count: int) -> int:
    """Return the width of an approximately square image, a multiple of 4 [px]."""
    return 4 * int(np.ceil(np.sqrt(count) / 4))


def _webp(pixels: UInt8[np.ndarray, "P 4"], width: int) -> bytes:
    """Encode pixels row by row; `exact` keeps the colours of transparent ones."""
    rows = -(-len(pixels) // width)
    padded = np.zeros((rows * width, 4), np.uint8)
    padded[: len(pixels)] = pixels
    content = io.BytesIO()
    Image.fromarray(padded.reshape(rows, width, 4)).save(content, "WEBP", lossless=True, exact=True, method=3)
    return content.getvalue()
