"""Wind that engines evaluate: turn modes of bones in a texture, coordinates as cosines, shaders.

A ZIP of `tree-bones.glb` (at rest; TEXCOORD_1 names the bone of each vertex), `bones.exr` (per bone Re θ_0, then
w_k Re θ_k and w_k Im θ_k of each further bin, its flutter, foot, direction and parent), `wind.json`, and shaders per
engine with the wind's numbers as constants.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files

import numpy as np
from jaxtyping import Float32, Int32

from dynamictree.formats.gltf.motion import loop_parts
from dynamictree.formats.gltf.writer import rest_glb
from dynamictree.formats.motion.vertex_texture import TextureLayout, exr_of, texture_layout
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turbulence import TurbulentWind
from dynamictree.rig.flutter import Flutter
from dynamictree.rig.rig import Rig
from dynamictree.up_axis import up_rotation
from dynamictree.wind.flutter import FLAP_RAD, TWIST_RAD
from dynamictree.wind_bands import DRAG_EXPONENT, drag_at

VERSION = 6
SHADERS = (
    "wind-three.js",
    "wind-godot.gd",
    "wind-godot-poses.gdshader",
    "wind-godot.gdshader",
    "wind-unity.shader",
    "wind-unity.hlsl",
    "wind-unreal-poses.hlsl",
    "wind-unreal.hlsl",
)


@dataclass(frozen=True, kw_only=True)
class BoneTexture:
    """Layout of `bones.exr`, with bones in place of vertices and parts in place of frames; and facts for shaders."""

    layout: TextureLayout
    num_bones: int
    most_ancestors: int
    farthest_m: float  # bound of a foot's coordinates and displacements

    @property
    def facts(self) -> dict[str, int]:
        """Fields of `wind.json`."""
        return {
            "width": self.layout.width,
            "height": self.layout.height,
            "rows_per_part": self.layout.rows_per_frame,
            "num_parts": self.layout.num_frames,
            "num_bones": self.num_bones,
            "most_ancestors": self.most_ancestors,
        }


def engine_wind_files(
    mesh: TriangleMesh, wind: TurbulentWind, rig: Rig, flutter: Flutter
) -> list[tuple[str, list[bytes]]]:
    """Return name and content of the archive's files.

    Raises:
        InputError: the bones do not fit into a texture.
    """
    skeleton, turns = rig.skeleton, rig.turns
    parts = _parts(rig, flutter)
    texture = BoneTexture(
        layout=texture_layout(len(turns), len(parts) + 1),  # one more for the parent
        num_bones=len(turns),
        most_ancestors=int(skeleton.depths.max()),
        farthest_m=2 * float(np.linalg.norm(mesh.vertices, axis=1).max()),
    )
    bone, of_parent = rig.vertices.rows[:, 0], rig.vertices.shares[:, 1]
    lookup = np.stack([(bone + 0.5) / texture.num_bones, of_parent], axis=1).astype(np.float32)
    facts = {
        "format": "engine-wind",
        "version": VERSION,
        "mesh": "tree-bones.glb",
        "texture": "bones.exr",
        **texture.facts,
        "flutter": {"period_s": flutter.period_s, "flap_rad": FLAP_RAD, "twist_rad": TWIST_RAD},
        "parts": "Re theta_0, then w_k Re theta_k and w_k Im theta_k of bins 1 to K - 1; tones of flutter; its "
        "critical speed and share; its axis; foot; direction; parent",
        "unit": "m",
        "axes": "+Y up, right-handed, as in glTF",
        "wind": _described(wind),
    }
    return [
        ("wind.json", [json.dumps(facts, indent=1).encode()]),
        ("tree-bones.glb", [rest_glb(mesh, lookup)]),
        ("bones.exr", [_picture(parts, skeleton.parent, texture.layout)]),
        *((name, [shader(name, wind, flutter.period_s, texture).encode()]) for name in SHADERS),
    ]


def _parts(rig: Rig, flutter: Flutter) -> Float32[np.ndarray, "M B 3"]:
    """Return the texture's parts but for the last, in glTF's axes."""
    y_up = up_rotation("+Y").astype(np.float32)  # multiplied from the right, it turns +Z up into +Y up
    skeleton = rig.skeleton
    turns = loop_parts(rig.turns, rig.num_frames).reshape(-1, len(skeleton), 3)
    tones = flutter.tones.swapaxes(0, 1) / np.array([1, 256, 256], np.float32)
    size = np.stack([flutter.critical_m_s, flutter.share, np.zeros_like(flutter.share)], axis=1)
    last = np.stack([flutter.axis, skeleton.foot_m, skeleton.directions])
    return np.concatenate([turns @ y_up, tones, size[None], last @ y_up]).astype(np.float32)


def _picture(parts: Float32[np.ndarray, "M B 3"], parent: Int32[np.ndarray, " B"], layout: TextureLayout) -> bytes:
    """Encode all parts, the last of which is where in a part the parent is, in [0, 1], or -1 for none."""
    column, row = parent % layout.width, parent // layout.width
    place = np.stack([(column + 0.5) / layout.width, (row + 0.5) / layout.rows_per_frame, 0 * column], axis=1)
    place[parent < 0] = -1
    texels = np.full((layout.num_frames, layout.rows_per_frame * layout.width, 3), -1, np.float16)
    texels[:, : len(parent)] = np.concatenate([parts, place[None]])
    return exr_of(texels.reshape(layout.height, layout.width, 3))


def shader(name: str, wind: TurbulentWind, period_s: float, texture: BoneTexture) -> str:
    """Return the shader code for one engine, with the wind's numbers and the texture's layout as constants."""
    # parts of the texture that a shader computes per frame: displacements of feet, turns, feet, parents' turns
    pose_parts = 4
    folder = files(__package__) / "wind_shaders"
    text, core, surface = (
        (folder / part).read_text(encoding="utf-8").rstrip() for part in (name, "core.glsl", "surface.glsl")
    )
    text = text.replace("CORE", core).replace("SURFACE", surface)
    waves = (wind.strength, wind.lean, wind.turn_rad)
    gusts = np.concatenate([np.stack([w.frequency_hz, w.amplitude, w.phase_rad], axis=1) for w in waves])
    partials = np.stack([wind.partial_hz[1:], wind.partial_phase_rad[1:]], axis=-1).reshape(-1, 2)
    num_parts = texture.layout.num_frames
    numbers = {
        "NUM_BINS": len(wind.frequencies_hz) - 1,
        "NUM_COORDINATES": len(wind.frequencies_hz),
        "NUM_PARTIALS": wind.partial_hz.shape[1],
        "NUM_GUSTS": len(wind.strength.frequency_hz),
        "NUM_BANDS": len(wind.bands.speeds_m_s),
        "STRENGTH_MEAN": wind.strength.mean,
        "STRENGTH_LIMIT": wind.strength.limit,
        "LEAN_MEAN": wind.lean.mean,
        "LEAN_LIMIT": wind.lean.limit,
        "TURN_LIMIT": wind.turn_rad.limit,
        "TONES": num_parts - 9,
        "FLAP": FLAP_RAD / np.sqrt(2),
        "TWIST": TWIST_RAD / np.sqrt(2),
        "PERIOD": period_s,
        "DRAG_ROOT": 1 / DRAG_EXPONENT,
        "ONSET": num_parts - 5,
        "AXIS": num_parts - 4,
        "FOOT": num_parts - 3,
        "DIRECTION": num_parts - 2,
        "PARENT": num_parts - 1,
        "MOST_ANCESTORS": texture.most_ancestors,
    }
    layout = {
        "NUM_BONES": float(texture.num_bones),
        "NUM_PARTS": float(num_parts),
        "WIDTH": float(texture.layout.width),
        "ROWS": float(texture.layout.rows_per_frame),
        "FARTHEST": texture.farthest_m,
    }
    text = text.replace("CONSTANTS", _defined(numbers | layout)).replace("LAYOUT", _defined(layout))
    text = text.replace("POSES_WIDTH", str(texture.layout.width))
    text = text.replace("POSES_HEIGHT", str(pose_parts * texture.layout.rows_per_frame))
    hlsl = name.endswith((".hlsl", ".shader"))
    source = "bones" if "BONE(" in text else "poses"
    text = text.replace("TEXTUREvec2", f"Texture2D {source}, SamplerState point_sampler, vec2" if hlsl else "vec2")
    text = text.replace("TEXTURES ", f"{source}, point_sampler, " if hlsl else "")
    gains = np.asarray(wind.bands.gains).reshape(-1, 1)
    drags = drag_at(np.asarray(wind.bands.speeds_m_s)[:, None])
    for table, rows in (("GUSTS", gusts), ("PARTIALS", partials), ("DRAGS", drags), ("GAINS", gains)):
        text = text.replace(f"{table}_TABLE", _table(table, rows, hlsl=hlsl))
    text = text.replace("OWN_M_S", _number(wind.wind.speed_m_s))
    if hlsl:
        for word, other in ((r"\bvec([23])\b", r"float\1"), (r"\bmix\(", "lerp("), (r"\bfract\(", "frac(")):
            text = re.sub(word, other, text)
    return text + "\n"


def _defined(numbers: Mapping[str, int | float]) -> str:
    return "\n".join(
        f"#define {key} {value if isinstance(value, int) else _number(value)}" for key, value in numbers.items()
    )


def _table(name: str, rows: np.ndarray, *, hlsl: bool) -> str:
    kind = f"vec{rows.shape[1]}" if rows.shape[1] > 1 else "float"
    values = ", ".join(f"{kind}({', '.join(map(_number, row))})" for row in rows.tolist())
    if hlsl:
        return f"static const {kind} {name}[{len(rows)}] = {{ {values} }};"
    return f"const {kind} {name}[{len(rows)}] = {kind}[{len(rows)}]({values});"


def _number(value: float) -> str:
    """Format a number with a point or an exponent: in a shader, 1 is an integer."""
    text = f"{value:.9g}"
    return text if "." in text or "e" in text else f"{text}.0"


def _described(wind: TurbulentWind) -> dict[str, object]:
    """Return the wind as in `GET /v1/spectra/{id}/wind`: partials from bin 1."""
    fields = {name: _json_value(value) for name, value in asdict(wind).items()}
    return fields | {name: _json_value(getattr(wind, name)[1:]) for name in ("partial_hz", "partial_phase_rad")}


def _json_value(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return {name: _json_value(one) for name, one in value.items()} if isinstance(value, dict) else value
