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
from recipes.wind_reference import coordinates, feet, half_turns, turned, wave_at


@dataclass(frozen=True, kw_only=True)
class EngineWind:
    """Content of the files for B bones and N vertices, +Z up."""

    wind: dict[str, Any]
    turns: np.ndarray  # modes [2K - 1, B, 3], rad
    foot_m: np.ndarray  # [B, 3]
    direction: np.ndarray  # [B, 3]
    parent: np.ndarray  # [B]
    vertices: np.ndarray  # [N, 3], m
    bone: np.ndarray  # [N]
    parent_share: np.ndarray  # [N]

    def displacement(self, seconds: float, speed_m_s: float | None = None) -> np.ndarray:
        """Return the vertices' displacement in a mean wind, by default the motion's own, [N, 3] [m]."""
        return self.pose(coordinates(self.wind, seconds, speed_m_s), wave_at(self.wind["turn_rad"], seconds))

    def pose(self, q: np.ndarray, wind_turn: float = 0.0) -> np.ndarray:
        """Return the displacement for modal coordinates [K] and a turn of the wind's direction, [N, 3] [m]."""
        theta = self.turns[0] * q[0].real + np.einsum("k,kbc->bc", q[1:].real, self.turns[1::2])
        theta -= np.einsum("k,kbc->bc", q[1:].imag, self.turns[2::2])
        half = half_turns(theta, self.direction, wind_turn)
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
    *turns, foot, direction, parent = parts
    column, row = np.floor(parent[:, 0] * width), np.floor(parent[:, 1] * rows)
    document = pygltflib.GLTF2().load_from_bytes(archive.read(facts["mesh"]))
    attributes = document.meshes[0].primitives[0].attributes
    u, share = accessor(document, attributes.TEXCOORD_1).T
    return EngineWind(
        wind=facts["wind"],
        turns=z_up(np.stack(turns)),
        foot_m=z_up(foot),
        direction=z_up(direction),
        parent=np.where(parent[:, 0] < 0, -1, row * width + column).astype(int),
        vertices=z_up(accessor(document, attributes.POSITION)),
        bone=np.floor(u.astype(np.float64) * count).astype(int),
        parent_share=share,
    )
