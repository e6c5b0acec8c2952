"""Run what api, worker and housekeeper run, once, so that the image holds the bytecode and numba's machine code of it.

`python warm_caches.py TREE.glb` in the image's build. Kernels of reconstruction are left out: its jobs take minutes.
"""

import importlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

FORMATS = {"glb": "glb,motion,png", "xyz": "splat,png"}
MODULES = (
    "service.app",
    "worker.app",
    "worker.tasks",
    "worker.stages",
    "worker.housekeeper",
    "worker.parse_server",
    "uvicorn.main",
    "pycolmap",
    "pyapriltags",
)


def main(tree: Path) -> None:
    """Import the processes' modules, then animate a mesh and a scan of the same tree."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DYNAMICTREE_STATE_DIR"] = folder
        for name in MODULES:
            importlib.import_module(name)
        scan = Path(folder) / "scan.xyz"
        _write_scan(tree, scan)
        for path in (tree, scan):
            formats = FORMATS[path.suffix.removeprefix(".")]
            command = ["animate", str(path), "--output", str(Path(folder) / path.suffix), "--format", formats]
            subprocess.run(
                [sys.executable, "-m", "dynamictree.cli", *command, "--frames", "2", "--no-loop"], check=True
            )


def _write_scan(tree: Path, scan: Path) -> None:
    import numpy as np

    from dynamictree.commands.input_files import load_mesh

    np.savetxt(scan, load_mesh(tree).vertices, fmt="%.4f")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
