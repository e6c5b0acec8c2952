"""The rig of a mesh and a spectrum, which does not depend on the products: computed once, and stored."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from dynamictree.export.moving_tree import Report
from dynamictree.formats.tensors.rig import read_rig, write_rig
from dynamictree.mesh import TriangleMesh
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.spectrum import SparseVoxelSpectrum

Result = Literal["rig", "reconstruction"]
"""The bones of a tree and how they turn; and what photos show."""
Recall = Callable[[Result, Callable[[Path], None]], Path]
"""Gives the file of a result; where there is none, calls the function that writes it to a path."""


def stored_rig(mesh: TriangleMesh, spectrum: SparseVoxelSpectrum, recall: Recall | None, report: Report) -> Rig:
    """The rig: from the file of an earlier product of the same motion, where there is one."""
    if recall is None:
        return rig_of(mesh, spectrum, report)

    def make(path: Path) -> None:
        with path.open("xb") as stream:
            write_rig(rig_of(mesh, spectrum, report), stream)

    with recall("rig", make).open("rb") as stream:
        return read_rig(stream)
