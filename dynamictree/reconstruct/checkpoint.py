"""State of `optimise` in a file, so that an interrupted run continues to the same result."""

from pathlib import Path

import numpy as np

from dynamictree.files import replacing
from dynamictree.reconstruct.adam import AdamState
from dynamictree.reconstruct.densify import Pull
from dynamictree.reconstruct.optimise import SplatProgress


def save_progress(progress: SplatProgress, path: Path) -> None:
    """Write the state; a crash leaves the previous file."""
    pull = progress.pull or Pull(len(progress.table))
    with replacing(path) as stream:
        np.savez(
            stream,
            table=progress.table,
            first=progress.moments.first,
            second=progress.moments.second,
            steps=np.array([progress.step, progress.moments.num_steps, progress.num_discarded]),
            best=progress.table[:0] if progress.best is None else progress.best,
            pull=np.stack([pull.total, pull.times]),
            best_psnr=np.array(progress.best_psnr),
            checks=np.array(progress.checks, np.float64).reshape(-1, 3),
        )


def load_progress(path: Path) -> SplatProgress:
    """Read what `save_progress` wrote."""
    with np.load(path, allow_pickle=False) as arrays:
        step, moment_steps, num_discarded = arrays["steps"].tolist()
        best = arrays["best"]
        pull = Pull(len(arrays["table"]))
        pull.total, pull.times = arrays["pull"]
        return SplatProgress(
            table=arrays["table"],
            moments=AdamState(first=arrays["first"], second=arrays["second"], num_steps=moment_steps),
            step=step,
            num_discarded=num_discarded,
            pull=pull,
            best=best if len(best) else None,
            best_psnr=float(arrays["best_psnr"]),
            checks=tuple((int(step), int(count), float(psnr_db)) for step, count, psnr_db in arrays["checks"]),
        )
