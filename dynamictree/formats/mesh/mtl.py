"""Materials of Wavefront MTL files: base colour, texture and alpha cutoff."""

import re
import unicodedata
from collections.abc import Mapping, Sequence

from dynamictree.formats.companions import find_companion
from dynamictree.formats.texture import refuse_many_pixels, texture_as_png
from dynamictree.mesh import Material, SourceWarning, refuse_many_materials

_NUMBER = r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?\s+"
_OPTIONS = re.compile(
    r"(?:-(?:blendu|blendv|cc|clamp)\s+(?:on|off)\s+|-[ost]\s+(?:" + _NUMBER + r"){1,3}|-mm\s+(?:" + _NUMBER + r"){2}"
    r"|-(?:bm|boost|texres)\s+" + _NUMBER + r"|-(?:imfchan|type|colorspace)\s+\w+\s+)*",
    re.IGNORECASE,
)
"""Options before the name of a texture: MTL specification, section on texture map options."""


def read_materials(
    names: Sequence[str], libraries: Sequence[str], companions: Mapping[str, bytes]
) -> tuple[tuple[Material, ...], list[SourceWarning]]:
    """Read the named materials, grey where no library describes them; return them with warnings.

    Raises:
        FormatError: a damaged texture.
        MeshError: too many materials.
    """
    refuse_many_materials(len(names))
    warnings: list[SourceWarning] = []
    fields: dict[str, dict[str, str]] = {}
    for library in libraries:
        contents = _libraries(library, names, companions)
        if not contents:
            message = f"material library {library[:120]!r} was not sent along; its materials are grey"
            warnings.append(SourceWarning(code="material-library-missing", message=message))
        for content in contents:
            fields |= _fields(text_of(content))
    images: dict[str, bytes] = {}
    described = [fields.get(_key(name)) for name in names]
    materials = [
        Material(name=name) if entry is None else _material(name, entry, companions, images, warnings)
        for name, entry in zip(names, described, strict=True)
    ]
    return tuple(materials), list(dict.fromkeys(warnings))


def text_of(content: bytes) -> str:
    """Decode UTF-8, or Latin-1, in which programs on Windows write names with umlauts."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _libraries(library: str, names: Sequence[str], companions: Mapping[str, bytes]) -> list[bytes]:
    """Find the files of a `mtllib` line: one name with blanks, several names, or the only MTL if its names match."""
    whole = find_companion(library, companions)
    if whole is not None:
        return [whole]
    several = [find_companion(name, companions) for name in library.split()]
    if any(several):
        return [content for content in several if content is not None]
    others = [name for name in companions if name.lower().endswith(".mtl")]
    if len(others) == 1 and {_key(name) for name in names} & set(_fields(text_of(companions[others[0]]))):
        return [companions[others[0]]]
    return []


def _key(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _fields(text: str) -> dict[str, dict[str, str]]:
    """Return the value of each keyword, by material name."""
    fields: dict[str, dict[str, str]] = {}
    current: dict[str, str] = {}
    for line in text.splitlines():
        keyword, rest = (*line.split(None, 1), "", "")[:2]
        if keyword.lower() == "newmtl":
            current = fields.setdefault(_key(rest.strip()[:200]), {})
        elif rest:
            current[keyword.lower()] = rest.strip()
    return fields


def _material(
    name: str,
    entry: Mapping[str, str],
    companions: Mapping[str, bytes],
    images: dict[str, bytes],
    warnings: list[SourceWarning],
) -> Material:
    """Build one material; `images` caches decoded textures."""
    cutoff = 0.5  # alpha cutoff of a material with a map_d
    red, green, blue = (_numbers(entry.get("kd", "")) * 3)[:3] or (0.8, 0.8, 0.8)
    opaque = _numbers(entry.get("d", "")) or [1 - number for number in _numbers(entry.get("tr", ""))] or [1.0]
    given = entry.get("map_kd", "").strip('"')
    texture = given
    content = find_companion(given, companions)  # names may have blanks
    if content is None:
        texture = given[_OPTIONS.match(given).end() :].strip('"')  # type: ignore[union-attr]
        content = find_companion(texture, companions)
    if texture and content is None:
        message = f"texture {texture[:120]!r} was not sent along; the model is used without it"
        warnings.append(SourceWarning(code="texture-missing", message=message))
    if content is not None and texture not in images:
        images[texture] = texture_as_png(content, texture[:80])
        refuse_many_pixels(images.values())
    return Material(
        name=name,
        base_color=(red, green, blue, opaque[-1]),
        texture_png=images.get(texture),
        alpha_cutoff=cutoff if "map_d" in entry else None,
    )


def _numbers(text: str) -> list[float]:
    """Parse the numbers of a line, clipped to [0, 1]; empty if it contains anything else, such as a spectral curve."""
    try:
        return [min(max(float(word), 0.0), 1.0) for word in text.removeprefix("-halo").split()]
    except ValueError:
        return []
