"""Draw docs/pictures/size.webp: a line across each of three crowns over one minute in the same turbulent wind.

Time runs downward. The frequencies of the crowns' highest vertices are printed, for docs/laws.md.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from dynamictree import method
from dynamictree.export.moving_tree import iter_turbulent_turns
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.render.picture import Renderer, RenderSettings
from dynamictree.requests import Wind
from dynamictree.rig.flutter import flutter_of
from dynamictree.rig.rig import rig_of
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "size.webp"
TREES = (("shrub", 3.0), ("round-broadleaf", 8.0), ("round-broadleaf", 25.6))
GROWN_SEED, SEED, WIND = 11, 3, Wind(speed_m_s=6.0)
FPS, DURATION_S = 12, 60
SIDE_PX, GAP_PX = 300, 8
LINE = 0.3  # position from the top [share of the picture's height]
TOP_SHARE = 0.05  # share of the vertices


def main() -> None:
    slices = []
    for species, height_m in TREES:
        tree = grow_tree(replace(SPECIES[species], height_m=(height_m, height_m)), np.random.default_rng(GROWN_SEED))
        mesh = tree.mesh
        spectrum = method.generate(method.voxelize(mesh), wind=WIND, seed=SEED)
        rig = rig_of(mesh, spectrum)
        times_s = np.arange(FPS * DURATION_S) / FPS
        wind = turbulent_wind(spectrum, seed=SEED)
        turns = iter_turbulent_turns(rig, wind, times_s, flutter_of(rig, spectrum))
        frames = (rig.displacement(theta, mesh.vertices, rig.vertices) for theta in turns)
        top = np.argsort(mesh.vertices[:, 2])[-max(round(TOP_SHARE * mesh.num_vertices), 1) :]
        highest: list[np.ndarray] = []
        slices.append(_lines(mesh, frames, top, highest))
        print(
            f"{mesh.height_m:.1f} m, period {spectrum.period_s:.3g} s: {_frequencies(np.stack(highest), mesh.height_m)}"
        )
    gap = np.full((len(slices[0]), GAP_PX, 3), 255, np.uint8)
    picture = np.concatenate([slices[0], gap, slices[1], gap, slices[2]], axis=1)
    Image.fromarray(picture).save(PICTURE, quality=70, method=6)
    print(PICTURE)


def _lines(
    mesh: TriangleMesh, frames: Iterator[Float32[np.ndarray, "N 3"]], top: np.ndarray, highest: list[np.ndarray]
) -> UInt8[np.ndarray, "T W 3"]:
    """Return one row of every frame's picture; append the displacement of the vertices `top` to `highest`."""

    def noted() -> Iterator[Float32[np.ndarray, "N 3"]]:
        for frame in frames:
            highest.append(frame[top])
            yield frame

    renderer = Renderer(mesh, RenderSettings(width=SIDE_PX, height=SIDE_PX))
    return np.stack([renderer.picture(frame)[round(LINE * SIDE_PX)] for frame in noted()])


def _frequencies(motion: Float32[np.ndarray, "T N 3"], height_m: float) -> str:
    swing = motion - motion.mean(axis=0)
    power = (np.abs(np.fft.rfft(swing * np.hanning(len(swing))[:, None, None], axis=0)) ** 2).sum(axis=2)  # [F, N]
    hz = np.fft.rfftfreq(len(swing), 1 / FPS)
    crown = swing.mean(axis=1)
    along = crown @ np.linalg.svd(crown, full_matrices=False)[2][0]
    strokes = np.count_nonzero((along[:-1] < 0) & (along[1:] >= 0)) / DURATION_S
    single = np.percentile((power * hz[:, None]).sum(axis=0) / power.sum(axis=0), [10, 50, 90])
    rms = np.sqrt((swing**2).sum(axis=2).mean()) / height_m
    return (
        f"strongest {hz[1 + power.sum(axis=1)[1:].argmax()]:.2f} Hz, {strokes:.2f} strokes a second, vertices "
        f"{' · '.join(f'{value:.2f}' for value in single)} Hz, rms {rms:.1%} of the height"
    )


if __name__ == "__main__":
    main()
