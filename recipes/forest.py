"""A forest of instances from one spectrum, in one GLB or USDZ: no two trees, or motions, move alike.

python -m recipes.forest tree.glb tree.spectrum.safetensors -o forest.glb --trees 100
"""

import argparse
from pathlib import Path

import numpy as np

from dynamictree import method
from dynamictree.commands.input_files import load_mesh
from dynamictree.formats.tensors.spectrum import read_spectrum
from recipes.forest_glb import TravellingGusts, plant_forest, write_forest_glb
from recipes.forest_usd import write_forest_usdz

USD_MOTIONS = 12
"""Default number of motions in a forest as USD, whose size grows with it."""


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path, help="the tree that the spectrum was made for")
    parser.add_argument("spectrum", type=Path, help="its *.spectrum.safetensors")
    parser.add_argument("-o", "--output", type=Path, default=Path("forest.glb"), help="forest.glb or forest.usdz")
    parser.add_argument("--trees", type=int, default=100)
    parser.add_argument("--spacing", type=float, help="metres from tree to tree; by the crown's width if not given")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gust-speed", type=float, help="gusts cross the forest at so many m/s; without it none do")
    parser.add_argument("--motions", type=int, help="instances: trees share so many motions")
    chosen = parser.parse_args(arguments)
    mesh = load_mesh(chosen.mesh)
    with chosen.spectrum.open("rb") as stream:
        spectrum = read_spectrum(stream)
    spacing_m = chosen.spacing or 0.9 * float(np.ptp(mesh.vertices[:, :2], axis=0).max())
    rng = np.random.default_rng(chosen.seed)
    wind_deg = spectrum.wind.direction_deg if spectrum.wind else 0.0
    gusts = None
    if chosen.gust_speed is not None:
        gusts = TravellingGusts(speed_m_s=chosen.gust_speed, wind_deg=wind_deg, period_s=spectrum.period_s)
    trees = plant_forest(rng, chosen.trees, num_frequencies=spectrum.num_frequencies, spacing_m=spacing_m, gusts=gusts)
    timing = {"num_frames": spectrum.num_frames, "fps": spectrum.fps, "wind_deg": wind_deg}
    coefficients = method.devoxelize(spectrum, mesh)
    with chosen.output.open("wb") as stream:
        if chosen.output.suffix.lower() == ".usdz":
            motions = chosen.motions or min(USD_MOTIONS, len(trees))
            write_forest_usdz(mesh, coefficients, trees, stream, num_motions=motions, **timing)
        else:
            write_forest_glb(mesh, coefficients, trees, stream, num_motions=chosen.motions, **timing)
    print(f"{chosen.output}: {len(trees)} trees, {chosen.output.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
