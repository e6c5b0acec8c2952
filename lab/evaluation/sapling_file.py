"""Trees that Blender's Sapling add-on baked, as `.npz` files: motions from another generator."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from dynamictree.errors import FormatError, InputError
from dynamictree.mesh import TriangleMesh

ARRAYS = ("vertices", "rest", "faces")


@dataclass(frozen=True, kw_only=True)
class SaplingTree:
    """One tree of the Sapling add-on with its motion."""

    name: str
    mesh: TriangleMesh
    displacement: Float32[np.ndarray, "T N 3"]  # displacement from the rest pose [m]


def sapling_files(folder: Path) -> list[Path]:
    """List the trees in a folder, or in its subfolder `sapling`.

    Raises:
        InputError: there are no trees.
    """
    inner = folder / "sapling"
    files = sorted((inner if inner.is_dir() else folder).glob("*.npz"))
    if not files:
        raise InputError(f"there is no .npz of a Sapling tree in {folder} or {inner}; give the folder that holds them")
    return files


def read_sapling(path: Path) -> SaplingTree:
    """Read one tree without its skeleton.

    Raises:
        FormatError: an array is missing.
    """
    with np.load(path, allow_pickle=False) as baked:
        missing = [name for name in ARRAYS if name not in baked]
        if missing:
            raise FormatError(f"{path} lacks {', '.join(missing)}; a tree has the arrays {', '.join(ARRAYS)}")
        moved, rest, faces = (baked[name] for name in ARRAYS)
    return SaplingTree(name=path.stem, mesh=TriangleMesh(vertices=rest, faces=faces), displacement=moved - rest)
