"""Evaluate the product `wind` as an engine does: bones from the texture, coordinates from the reference code."""

import json
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib

from benchmarks._read_exports import accessor, z_up
from recipes.wind_reference import coordinates, feet, flutter, half_turns, turned, wave_at


@dataclass(frozen=True, kw_only=True)
class EngineWind:
    """Content of the files for B bones and N vertices, +Z up."""

    wind: dict[str, Any]
    constants: dict[str, float]  # constants of the flutter
    turns: np.ndarray  # modes [2K - 1, B, 3], rad
    tones: np.ndarray  # [J, B, 3]
    onset: np.ndarray  # critical speed [m/s] and share of the flutter [B, 2]
    axis: np.ndarray  # [B, 3]
    foot_m: np.ndarray  # [B, 3]
    direction: np.ndarray  # [B, 3]
    parent: np.ndarray  # [B]
    vertices: np.ndarray  # [N, 3], m
    bone: np.ndarray  # [N]
    parent_share: np.ndarray  # [N]

    def displacement(self, seconds: float, speed_m_s: float | None = None) -> np.ndarray:
        """Return the vertices' displacement in a mean wind, by default the motion's own, [N, 3] [m]."""
        speed = self.wind["wind"]["speed_m_s"] if speed_m_s is None else speed_m_s
        air_m_s = speed * wave_at(self.wind["strength"], seconds) ** (1 / 1.4)
        leaf = flutter(self.constants, self.tones, self.onset, self.axis, self.direction, seconds, air_m_s)
        return self.pose(coordinates(self.wind, seconds, speed), wave_at(self.wind["turn_rad"], seconds), leaf)

    def pose(self, q: np.ndarray, wind_turn: float = 0.0, leaf: np.ndarray | None = None) -> np.ndarray:
        """Return the displacement for coordinates [K], a turn of the wind and the leaves' rotations, [N, 3] [m]."""
        theta = self.turns[0] * q[0].real + np.einsum("k,kbc->bc", q[1:].real, self.turns[1::2])
        theta -= np.einsum("k,kbc->bc", q[1:].imag, self.turns[2::2])
        half = half_turns(theta, self.direction, wind_turn, np.zeros_like(theta) if leaf is None else leaf)
        moved = feet(half, self.foot_m, self.parent)[self.bone]
        share, arm = self.parent_share[:, None], self.vertices - self.foot_m[self.bone]
        by_parent = turned(half[np.maximum(self.parent, 0)[self.bone]], arm)
        return np.asarray(moved + (1 - share) * turned(half[self.bone], arm) + share * by_parent - arm)


def read_engine_wind(archive: zipfile.ZipFile) -> EngineWind:
    """Read the product from its archive. Needs OpenEXR."""
    import OpenEXR

    facts = json.loads(archive.read("wind.json"))
    with tempfile.TemporaryDirectory() as folder:
        (picture := Path(folder) / facts["texture"]).write_bytes(archive.read(facts["texture"]))
        texels = OpenEXR.File(str(picture)).channels()["RGB"].pixels.astype(np.float64)
    width, rows, count = facts["width"], facts["rows_per_part"], facts["num_bones"]
    parts = texels.reshape(facts["num_parts"], rows * width, 3)[:, :count]
    *turns, onset, axis, foot, direction, parent = parts
    turns, tones = turns[:-4], np.stack(turns[-4:])
    column, row = np.floor(parent[:, 0] * width), np.floor(parent[:, 1] * rows)
    document = pygltflib.GLTF2().load_from_bytes(archive.read(facts["mesh"]))
    attributes = document.meshes[0].primitives[0].attributes
    u, share = accessor(document, attributes.TEXCOORD_1).T
    return EngineWind(
        wind=facts["wind"],
        constants=facts["flutter"],
        turns=z_up(np.stack(turns)),
        tones=tones,
        onset=onset[:, :2],
        axis=z_up(axis),
        foot_m=z_up(foot),
        direction=z_up(direction),
        parent=np.where(parent[:, 0] < 0, -1, row * width + column).astype(int),
        vertices=z_up(accessor(document, attributes.POSITION)),
        bone=np.floor(u.astype(np.float64) * count).astype(int),
        parent_share=share,
    )
