"""Draw the figure of docs/method.md: amplitude over a tree's voxels, and spectra of single voxels."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from lab.dataset.sample import make_sample, voxel_spectrum

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "spectrum.png"
BINS = (1, 4, 12)


def main() -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    _, spectrum = voxel_spectrum(make_sample(7, "round-broadleaf"))
    x, y, z = spectrum.grid.centres_m.T
    amplitude_mm = 2e3 * np.linalg.norm(spectrum.coefficients, axis=2)  # [V, K]
    figure = plt.figure(figsize=(12, 8), facecolor="white")
    low, high = np.log10(np.percentile(amplitude_mm[:, 1:], (2, 99.5)))
    for place, k in enumerate(BINS):
        axes = figure.add_subplot(2, 3, place + 1)
        order = np.argsort(-y)
        points_drawn = axes.scatter(
            x[order], z[order], c=np.log10(amplitude_mm[order, k] + 1e-9), s=2, vmin=low, vmax=high, cmap="magma"
        )
        axes.set_title(f"k = {k}, {spectrum.frequencies_hz[k]:.2f} Hz")
        axes.set_aspect("equal")
        axes.set_axis_off()
    figure.colorbar(points_drawn, ax=figure.axes, label="log10 amplitude [mm]", shrink=0.7)
    axes = figure.add_subplot(2, 1, 2)
    reach = np.hypot(x - x.mean(), y - y.mean())
    height = (z - z.min()) / np.ptp(z)
    voxels = {
        "trunk, a third up": int(np.argmin(reach + 9 * np.abs(height - 0.33))),
        "inside the crown": int(np.argmin(np.abs(reach - 0.4 * reach.max()) + 9 * np.abs(height - 0.7))),
        "outermost leaf": int(np.argmax(reach)),
    }
    for name, voxel in voxels.items():
        axes.semilogy(spectrum.frequencies_hz[1:], amplitude_mm[voxel, 1:], "o-", label=name)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(PICTURE, dpi=90, bbox_inches="tight", pil_kwargs={"optimize": True})
    print(PICTURE)


if __name__ == "__main__":
    main()
