"""Appearance of a mesh's surface: colours, textures with cut-outs, or two default clay colours."""

from io import BytesIO
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Int32
from PIL import Image

from dynamictree.color import STILL_SHARE, greyed, linear_from_bytes
from dynamictree.errors import FormatError
from dynamictree.mesh import Material, TriangleMesh, connected_parts
from dynamictree.parallel import compiled

_MAX_TEXELS = 64_000_000  # number in all textures and levels, 1 GB; more textures are reduced further
_WOOD, _LEAF = (0.235, 0.180, 0.135), (0.180, 0.270, 0.095)  # linear colours of a mesh without colours


class Appearance(NamedTuple):
    """Appearance of a mesh as arrays for kernels; colours are linear."""

    uv: Float32[np.ndarray, "N 2"]
    vertex_rgb: Float32[np.ndarray, "N 3"]
    face_material: Int32[np.ndarray, " F"]
    material_rgb: Float32[np.ndarray, "M 3"]
    material_alpha: Float32[np.ndarray, " M"]
    cutoff: Float32[np.ndarray, " M"]  # alpha below which a face is cut out; 0 for opaque
    transmission: Float32[np.ndarray, " M"]  # share of sunlight that passes through
    texture_levels: Int32[np.ndarray, "M L 3"]  # first texel, width, height of each mip level; width 0 if missing
    texels: Float32[np.ndarray, "P 4"]  # RGB times alpha, and alpha


def appearance_of(mesh: TriangleMesh, *, grey_still: bool = False) -> Appearance:
    """Collect the mesh's colours; use two clay colours, wood and leaf, if it has none.

    With `grey_still`, still parts, which are no plant, are grey.

    Raises:
        FormatError: a texture is not a picture, or is too large.
    """
    leaf_transmission = 0.5  # share of the light on a leaf's far side
    has_colors = mesh.look.vertex_colors is not None or any(
        material.texture_png is not None or material.base_color != Material().base_color
        for material in mesh.look.materials
    )
    if has_colors:
        materials = mesh.look.materials or (Material(base_color=(1.0, 1.0, 1.0, 1.0)),)
        face_material = (
            mesh.look.face_material if mesh.look.face_material is not None else np.zeros(mesh.num_faces, np.int32)
        )
    else:
        materials = (Material(base_color=(*_WOOD, 1.0)), Material(base_color=(*_LEAF, 1.0)))
        face_material = foliage_faces(mesh.faces, mesh.num_vertices).astype(np.int32)
    leafy = [is_leafy(material) for material in materials] if has_colors else [False, True]
    colors = mesh.look.vertex_colors
    vertex_rgb = np.ones((mesh.num_vertices, 3), np.float32) if colors is None else linear_from_bytes(colors[:, :3])
    num_colored = len(materials)
    if grey_still and mesh.still_faces is not None:  # duplicate each material for the still faces
        face_material = np.where(mesh.still_faces, face_material + num_colored, face_material)
        materials, leafy = (*materials, *materials), [*leafy, *leafy]
        vertex_rgb[mesh.still_vertices] = greyed(vertex_rgb[mesh.still_vertices])
    used = np.unique(face_material)
    texels, levels = _texels(materials, num_colored, used)
    base = np.array([material.base_color for material in materials], np.float32)
    base[num_colored:, :3] = STILL_SHARE * greyed(base[num_colored:, :3])
    cutoff = np.array([material.alpha_cutoff or 0 for material in materials], np.float32)
    return Appearance(
        uv=np.zeros((mesh.num_vertices, 2), np.float32) if mesh.look.uv is None else np.array(mesh.look.uv, np.float32),
        vertex_rgb=vertex_rgb,
        face_material=np.array(face_material, np.int32),
        material_rgb=np.ascontiguousarray(base[:, :3]),
        material_alpha=np.ascontiguousarray(base[:, 3]),
        cutoff=cutoff,
        transmission=np.where(leafy, leaf_transmission, 0).astype(np.float32),
        texture_levels=levels,
        texels=texels,
    )


def _texels(
    materials: tuple[Material, ...], num_colored: int, used: Int32[np.ndarray, " U"]
) -> tuple[Float32[np.ndarray, "P 4"], Int32[np.ndarray, "M L 3"]]:
    """Decode the texels of all mip levels, with the start of each material's levels; grey from `num_colored` on.

    A texture of several materials is decoded once; unused grey copies of materials get no texels.
    """
    num_levels = 11  # sides 1024 down to 1
    levels = np.zeros((len(materials), num_levels, 3), np.int32)
    texels, num_texels = [np.zeros((1, 4), np.float32)], 1
    rows = [row for row in range(len(materials)) if row < num_colored or row in used]
    textures = [(row, png) for row in rows if (png := materials[row].texture_png) is not None]
    row_of: dict[tuple[bytes, bool], int] = {}  # the first material of a texture; others share its texels
    side_px = _side_px(len({(png, row >= num_colored) for row, png in textures}))
    for row, png in textures:
        grey = row >= num_colored
        first = row_of.setdefault((png, grey), row)
        if first < row:
            levels[row] = levels[first]
            continue
        for level, image in enumerate(_mip_levels(png, side_px)):
            if grey:
                image[..., :3] = greyed(image[..., :3])
            levels[row, level] = num_texels, image.shape[1], image.shape[0]
            texels.append(image.reshape(-1, 4))
            num_texels += image.shape[0] * image.shape[1]
    return np.concatenate(texels), levels


def is_leafy(material: Material) -> bool:
    """Whether a material is of leaves, by an alpha cut-out or by its name."""
    named = any(word in material.name.lower() for word in ("leaf", "leaves", "foliage", "needle"))
    return named or material.alpha_cutoff is not None


def foliage_faces(faces: Int32[np.ndarray, "F 3"], num_vertices: int) -> Bool[np.ndarray, " F"]:
    """Whether each face belongs to a small separate piece, like leaves."""
    leaf_faces = 32  # largest number of faces in a separate piece that counts as a leaf
    piece = connected_parts(faces, num_vertices)
    size = np.bincount(piece[faces[:, 0]], minlength=int(piece.max(initial=-1)) + 1)
    small = size <= leaf_faces
    if small[size > 0].all():  # all pieces are small: the mesh has no shared vertices
        return np.zeros(len(faces), bool)
    leaves: Bool[np.ndarray, " F"] = small[piece[faces[:, 0]]]
    return leaves


def _side_px(num_textures: int) -> int:
    """Return the side to which textures are reduced so that all fit into `_MAX_TEXELS`."""
    texture_side_px = 1024  # larger textures exceed the resolution of pictures and are reduced
    side_px = texture_side_px
    while side_px > 1 and num_textures * side_px**2 * 4 // 3 > _MAX_TEXELS:
        side_px //= 2
    return side_px


def _mip_levels(texture: bytes, side_px: int) -> list[Float32[np.ndarray, "H W 4"]]:
    max_texture_pixels = 64_000_000
    try:
        with Image.open(BytesIO(texture)) as image:
            if image.width * image.height > max_texture_pixels:
                size = f"{image.width} x {image.height} pixels"
                raise FormatError(f"a texture has {size}; at most {max_texture_pixels:,} are allowed; reduce it")
            pixels = np.array(image.convert("RGBA"))
    except (OSError, Image.DecompressionBombError) as error:
        raise FormatError(f"a texture of {len(texture):,} bytes is no picture that can be read: {error}") from error
    rgba = np.concatenate([linear_from_bytes(pixels[..., :3]), pixels[..., 3:].astype(np.float32) / 255], axis=2)
    rgba[..., :3] *= rgba[..., 3:]
    levels = [rgba]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(_halved(levels[-1]))
    too_large = [level for level in levels if max(level.shape[:2]) > side_px]
    return levels[len(too_large) :]


def _halved(image: Float32[np.ndarray, "H W 4"]) -> Float32[np.ndarray, "h w 4"]:
    height, width = image.shape[:2]
    padded = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.ascontiguousarray(padded.reshape(-(-height // 2), 2, -(-width // 2), 2, 4).mean(axis=(1, 3)))


@compiled
@no_type_check
def _uv_at(appearance, corners, weights):
    a, b, c = weights
    total = a + b + c
    ua, ub, uc = appearance.uv[corners[0]], appearance.uv[corners[1]], appearance.uv[corners[2]]
    return (a * ua[0] + b * ub[0] + c * uc[0]) / total, (a * ua[1] + b * ub[1] + c * uc[1]) / total


@compiled
@no_type_check
def alpha_at(appearance, corners, material, level, weights):
    """Sample alpha at the nearest texel, at barycentric coordinates of any scale."""
    offset, width, height = appearance.texture_levels[material, level]
    alpha = appearance.material_alpha[material]
    if width == 0:
        return alpha
    u, v = _uv_at(appearance, corners, weights)
    x, y = int(np.floor(u * width)) % width, int(np.floor(v * height)) % height
    return alpha * appearance.texels[offset + y * width + x, 3]


@compiled
@no_type_check
def albedo_at(appearance, corners, material, level, weights):
    """Sample the linear colour: vertex colours times base colour times the texture, bilinear."""
    a, b, c = weights
    total = a + b + c
    rgb = appearance.vertex_rgb
    ca, cb, cc = rgb[corners[0]], rgb[corners[1]], rgb[corners[2]]
    base = appearance.material_rgb[material]
    red = base[0] * (a * ca[0] + b * cb[0] + c * cc[0]) / total
    green = base[1] * (a * ca[1] + b * cb[1] + c * cc[1]) / total
    blue = base[2] * (a * ca[2] + b * cb[2] + c * cc[2]) / total
    offset, width, height = appearance.texture_levels[material, level]
    if width == 0:
        return red, green, blue
    u, v = _uv_at(appearance, corners, weights)
    x, y = u * width - 0.5, v * height - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - left, y - top
    texel_red, texel_green, texel_blue, alpha = 0.0, 0.0, 0.0, 1e-6
    for step in range(4):
        dx, dy = step % 2, step // 2
        weight = (fx if dx else 1 - fx) * (fy if dy else 1 - fy)
        texel = appearance.texels[offset + (top + dy) % height * width + (left + dx) % width]
        texel_red += weight * texel[0]
        texel_green += weight * texel[1]
        texel_blue += weight * texel[2]
        alpha += weight * texel[3]
    return red * texel_red / alpha, green * texel_green / alpha, blue * texel_blue / alpha
