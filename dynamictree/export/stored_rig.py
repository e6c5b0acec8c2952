"""The rig of a mesh and a spectrum, shared by all products: computed once, and stored."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from dynamictree.export.moving_tree import Report
from dynamictree.formats.tensors.rig import read_rig, write_rig
from dynamictree.mesh import TriangleMesh
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.spectrum import SparseVoxelSpectrum

Result = Literal["rig", "reconstruction"]
"""Results that are stored: the rig of a tree, and the reconstruction from photos."""
Recall = Callable[[Result, Callable[[Path], None]], Path]
"""Returns the file of a result; if there is none, calls the function that writes it to a path."""


def stored_rig(mesh: TriangleMesh, spectrum: SparseVoxelSpectrum, recall: Recall | None, report: Report) -> Rig:
    """Return the rig, from the file of an earlier product of the same motion if there is one."""
    if recall is None:
        return rig_of(mesh, spectrum, report)

    def make(path: Path) -> None:
        with path.open("xb") as stream:
            write_rig(rig_of(mesh, spectrum, report), stream)

    with recall("rig", make).open("rb") as stream:
        return read_rig(stream)
