"""The product `wind` as an engine evaluates it: mode shapes out of the texture, coordinates by the reference."""

import json
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib

from benchmarks._played import accessor, z_up
from recipes.wind_reference import coordinates, turned, wave_at


@dataclass(frozen=True, kw_only=True)
class EngineWind:
    """What the files hold of each vertex, +Z up."""

    wind: dict[str, Any]
    modes: np.ndarray  # [2K - 1, N, 3], m
    turns: np.ndarray  # [2K - 1, N, 3], rad
    arms: np.ndarray  # [N, 3], m

    @property
    def in_card(self) -> np.ndarray:
        """Whether a vertex turns about a pivot, or is one [N]."""
        return np.asarray((self.turns != 0).any(axis=(0, 2)))

    def displacement(self, seconds: float, speed_m_s: float | None = None) -> np.ndarray:
        """Of the vertices in a mean wind, by default the motion's own [N, 3], m."""
        q = coordinates(self.wind, seconds, speed_m_s)
        turn = wave_at(self.wind["turn_rad"], seconds)
        cosine, sine = np.cos(turn), np.sin(turn)
        around = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])

        def added(parts: np.ndarray) -> np.ndarray:
            total = parts[0] * q[0].real + np.einsum("k,knc->nc", q[1:].real, parts[1::2])
            return np.asarray((total - np.einsum("k,knc->nc", q[1:].imag, parts[2::2])) @ around)

        return added(self.modes) + turned(added(self.turns), self.arms) - self.arms


def read_engine_wind(archive: zipfile.ZipFile) -> EngineWind:
    """Needs OpenEXR."""
    import OpenEXR

    facts = json.loads(archive.read("wind.json"))
    with tempfile.TemporaryDirectory() as folder:
        (picture := Path(folder) / "modes.exr").write_bytes(archive.read("modes.exr"))
        texels = OpenEXR.File(str(picture)).channels()["RGB"].pixels.astype(np.float64)
    document = pygltflib.GLTF2().load_from_bytes(archive.read("tree-modes.glb"))
    u, v = accessor(document, document.meshes[0].primitives[0].attributes.TEXCOORD_1).T
    column, step = np.floor(u * facts["width"]).astype(int), facts["rows_per_part"] / facts["height"]

    def parts(first: int, count: int) -> np.ndarray:
        rows = [np.floor((v + part * step) * facts["height"]).astype(int) for part in range(first, first + count)]
        return z_up(np.stack([texels[row, column] for row in rows]))

    count, cards = facts["num_parts"], facts["cards"]
    modes = parts(0, count)
    turns = np.zeros_like(modes) if cards is None else parts(cards["turns"], count)
    arms = np.zeros_like(modes[0]) if cards is None else parts(cards["arm"], 2).sum(axis=0)
    return EngineWind(wind=facts["wind"], modes=modes, turns=turns, arms=arms)
