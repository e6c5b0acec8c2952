"""Draw docs/pictures/laws.png from a report: `dynamictree evaluate --laws --trees 200 --json > laws.json`."""

import json
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

from dynamictree.modal.real_trees import height_law_hz
from lab.evaluation.laws import MEASURED_FROM_M, MEASURED_SPREAD, MEASURED_TO_M, MODEL_BANDS_HZ

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "laws.png"
MEASURED_SLOPE = -1.07


def main() -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    trees = json.loads(Path(sys.argv[1]).read_text())["trees"]
    height, frequency, slope, response, storm = (
        np.array([tree[name] for tree in trees])
        for name in ("height_m", "frequency_hz", "spectral_slope", "response", "response_in_storm")
    )
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4), facecolor="white", layout="constrained")
    for (low, high), band in MODEL_BANDS_HZ.items():
        left.fill_between([low, high], *band, color="tab:gray", alpha=0.2, lw=0)
    tall = np.geomspace(MEASURED_FROM_M, MEASURED_TO_M, 50)
    low, high = (spread * height_law_hz(tall) for spread in MEASURED_SPREAD)
    left.fill_between(tall, low, high, color="tab:green", alpha=0.2, lw=0)
    left.loglog(height, frequency, ".", ms=4, label="simulator, ring-down")
    title = "green: measured, grey: models"
    left.set(xlabel="height [m]", ylabel="lowest frequency [Hz]", title=title)
    left.legend()
    middle.hist(slope, 25)
    middle.axvline(MEASURED_SLOPE, color="tab:green", label="plant videos")
    middle.set(xlabel="exponent of amplitude with frequency, above 1 Hz", ylabel="trees")
    middle.legend()
    right.axvspan(1.4, 2.0, color="tab:green", alpha=0.2, lw=0, label="measured")
    right.hist(response, 25, alpha=0.8, label="1.25 to 2.5 m/s")
    right.hist(storm, 25, alpha=0.6, label="10 to 20 m/s")
    right.set(xlabel="exponent of displacement with wind speed", ylabel="trees")
    right.legend()
    figure.savefig(PICTURE, dpi=80, pil_kwargs={"optimize": True})
    print(PICTURE)


if __name__ == "__main__":
    main()
