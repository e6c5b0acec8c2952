"""Wind that engines evaluate: mode shapes in a texture, coordinates as cosines, shaders, baked vertex attributes.

A ZIP of `tree-modes.glb` (at rest; TEXCOORD_1 is the lookup), `modes.exr` (Re c_0, then w_k Re c_k and w_k Im c_k of
each further bin, laid out as the frames of a vertex texture; those of leaf cards are followed by turns and arms, see
`card_turns.py`), `wind.json`, a shader per engine that has the wind's
numbers inside, `tree-wind.glb`, whose vertex colours and texture coordinates a foliage shader reads, and the files of
`pivot_painter.py`.
"""

import io
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib.resources import files

import numpy as np
from jaxtyping import Complex64, Float32

from dynamictree.export.card_turns import CardTurns
from dynamictree.export.pivot_painter import PIVOT_PAINTER, pivot_painter_files
from dynamictree.formats.axes import up_rotation
from dynamictree.formats.gltf.motion import loop_parts
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.formats.motion.vertex_texture import TextureLayout, plain_vertex_texture, texture_layout
from dynamictree.formats.stored_zip import iter_stored_zip
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.branch_pivots import BranchPivots
from dynamictree.modal.turbulence import TurbulentWind
from dynamictree.wind_bands import DRAG_EXPONENT

VERSION = 3
_CARDS = (
    "#define TURN(part) MODE((part) + 2 * NUM_BINS + 1)",
    "#define ARM (MODE(4 * NUM_BINS + 2) + MODE(4 * NUM_BINS + 3))",
)
_NO_CARDS = ("#define TURN(part) vec3(0.0, 0.0, 0.0)", "#define ARM vec3(0.0, 0.0, 0.0)")
SHADERS = ("wind-three.js", "wind-godot.gdshader", "wind-unity.hlsl", "wind-unreal.hlsl")


def iter_engine_wind_zip(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    wind: TurbulentWind,
    pivots: BranchPivots,
    cards: CardTurns | None,
    *,
    num_frames: int,
) -> Iterator[bytes]:
    """Chunks of the archive; `num_frames` is T of the spectrum, `cards` are those of the mesh.

    Raises:
        InputError: no texture holds the mode shapes.
    """

    def parts_of(modes: Complex64[np.ndarray, "N K 3"]) -> Float32[np.ndarray, "M N 3"]:
        return loop_parts(modes, num_frames).reshape(-1, mesh.num_vertices, 3)

    moved = parts_of(coefficients if cards is None else cards.moved)
    turned = [] if cards is None else [parts_of(cards.turn), _in_halves(cards.arm_m)]
    layout = texture_layout(mesh.num_vertices, len(moved) + sum(map(len, turned)))
    rest, picture, rounding = plain_vertex_texture(mesh, layout, moved, *turned)
    facts = {
        "format": "engine-wind",
        "version": VERSION,
        "mesh": "tree-modes.glb",
        "texture": "modes.exr",
        "baked": "tree-wind.glb",
        "pivot_painter": PIVOT_PAINTER,
        "width": layout.width,
        "height": layout.height,
        "rows_per_part": layout.rows_per_frame,
        "num_parts": len(moved),
        "parts": "Re c_0, then w_k Re c_k and w_k Im c_k of bins 1 to K - 1",
        "cards": None if cards is None else {"turns": len(moved), "arm": 2 * len(moved), "rounding_rad": rounding[1]},
        "unit": "m",
        "axes": "+Y up, right-handed, as in glTF",
        "half_float_error_m": rounding[0],
        "wind": _described(wind),
    }
    shaders = ((name, [shader(name, wind, layout, cards=cards is not None).encode()]) for name in SHADERS)
    yield from iter_stored_zip(
        [
            ("wind.json", [json.dumps(facts, indent=1).encode()]),
            ("tree-modes.glb", [rest]),
            ("modes.exr", [picture]),
            ("tree-wind.glb", [baked_glb(mesh, coefficients, wind, pivots)]),
            *((name, [content]) for name, content in pivot_painter_files(mesh, pivots).items()),
            *shaders,
        ]
    )


def _in_halves(vectors: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "2 N 3"]:
    """The vectors as halves hold them, and what is missing then."""
    rounded = vectors.astype(np.float16).astype(np.float32)
    return np.stack([rounded, vectors - rounded])


def shader(name: str, wind: TurbulentWind, layout: TextureLayout, *, cards: bool) -> str:
    """Code for one engine with the wind's numbers and the texture's layout inside; `cards`: whether it holds turns."""
    folder = files(__package__) / "wind_shaders"
    text = (folder / name).read_text(encoding="utf-8").rstrip()
    text = text.replace("CORE", (folder / "core.glsl").read_text(encoding="utf-8").rstrip())
    waves = (wind.strength, wind.lean, wind.turn_rad)
    gusts = np.concatenate([np.stack([w.frequency_hz, w.amplitude, w.phase_rad], axis=1) for w in waves])
    partials = np.stack([wind.partial_hz[1:], wind.partial_phase_rad[1:]], axis=-1).reshape(-1, 2)
    numbers = {
        "NUM_BINS": len(wind.frequencies_hz) - 1,
        "NUM_PARTIALS": wind.partial_hz.shape[1],
        "NUM_GUSTS": len(wind.strength.frequency_hz),
        "NUM_BANDS": len(wind.bands.speeds_m_s),
        "STRENGTH_MEAN": wind.strength.mean,
        "STRENGTH_LIMIT": wind.strength.limit,
        "LEAN_MEAN": wind.lean.mean,
        "LEAN_LIMIT": wind.lean.limit,
        "TURN_LIMIT": wind.turn_rad.limit,
        "PART_STEP": layout.rows_per_frame / layout.height,
    }
    lines = [f"#define {key} {value if isinstance(value, int) else _number(value)}" for key, value in numbers.items()]
    lines += _CARDS if cards else _NO_CARDS
    text = text.replace("CONSTANTS", "\n".join(lines))
    hlsl = name.endswith(".hlsl")
    text = text.replace("TEXTURE", "Texture2D modes, SamplerState point_sampler, " if hlsl else "")
    gains = np.asarray(wind.bands.gains).reshape(-1, 1)
    drags = np.asarray(wind.bands.speeds_m_s)[:, None] ** DRAG_EXPONENT
    for table, rows in (("GUSTS", gusts), ("PARTIALS", partials), ("DRAGS", drags), ("GAINS", gains)):
        text = text.replace(f"{table}_TABLE", _table(table, rows, hlsl=hlsl))
    text = text.replace("OWN_M_S", _number(wind.wind.speed_m_s))
    return (re.sub(r"\bvec([23])\b", r"float\1", text) if hlsl else text) + "\n"


def _table(name: str, rows: np.ndarray, *, hlsl: bool) -> str:
    kind = f"vec{rows.shape[1]}" if rows.shape[1] > 1 else "float"
    values = ", ".join(f"{kind}({', '.join(map(_number, row))})" for row in rows.tolist())
    if hlsl:
        return f"static const {kind} {name}[{len(rows)}] = {{ {values} }};"
    return f"const {kind} {name}[{len(rows)}] = {kind}[{len(rows)}]({values});"


def _number(value: float) -> str:
    """A number with a point or an exponent: to a shader, 1 is an integer."""
    text = f"{value:.9g}"
    return text if "." in text or "e" in text else f"{text}.0"


def baked_glb(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"], wind: TurbulentWind, pivots: BranchPivots
) -> bytes:
    """The mesh at rest with wind weight, phase and stiffness as vertex colours, and branch pivots as UV sets."""
    power = (np.abs(coefficients[:, 1:]) ** 2).sum(axis=2)  # [N, K - 1]
    size = np.sqrt(2 * power.sum(axis=1) + (np.abs(coefficients[:, 0]) ** 2).sum(axis=1))
    strongest = int(power.sum(axis=0).argmax())
    swing = coefficients[:, 1 + strongest]
    axis = int((np.abs(swing) ** 2).sum(axis=0).argmax())
    phase = (np.angle(swing[:, axis]) / (2 * np.pi)) % 1
    mean_hz = power @ wind.frequencies_hz[1:] / np.maximum(power.sum(axis=1), 1e-30)
    columns = [size / max(float(size.max()), 1e-30), phase, mean_hz / wind.frequencies_hz[-1], np.ones(len(size))]
    colours = np.round(np.stack(columns, axis=1).clip(0, 1) * 65535).astype(np.uint16)
    pivot = pivots.pivot_m @ up_rotation("+Y").astype(np.float32)
    writer = GlbWriter(extras={"largest_weight_m": float(size.max()), "highest_hz": float(wind.frequencies_hz[-1])})
    sets: Mapping[str, Float32[np.ndarray, "N 2"]] = {
        **({"TEXCOORD_0": np.zeros((mesh.num_vertices, 2), np.float32)} if mesh.uv is None else {}),
        "TEXCOORD_1": pivot[:, :2],
        "TEXCOORD_2": np.stack([pivot[:, 2], pivots.order.astype(np.float32)], axis=1),
    }
    attributes = {
        name: writer.add_accessor(np.ascontiguousarray(values), target=VERTEX_BUFFER) for name, values in sets.items()
    }
    attributes["COLOR_0"] = writer.add_accessor(colours, target=VERTEX_BUFFER, normalized=True)
    add_mesh(writer, mesh, more_attributes=attributes)
    writer.append("nodes", {"mesh": 0, "name": "tree"})
    stream = io.BytesIO()
    writer.finish(stream)
    return stream.getvalue()


def _described(wind: TurbulentWind) -> dict[str, object]:
    """The wind as `GET /v1/spectra/{id}/wind` gives it: partials from bin 1."""
    fields = {name: _plain(value) for name, value in asdict(wind).items()}
    return fields | {name: _plain(getattr(wind, name)[1:]) for name in ("partial_hz", "partial_phase_rad")}


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return {name: _plain(one) for name, one in value.items()} if isinstance(value, dict) else value
