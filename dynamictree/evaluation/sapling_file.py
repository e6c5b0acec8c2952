"""Trees that Blender's Sapling add-on baked, as `.npz` of arrays: a motion that our generator did not make."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int32
from scipy.spatial import cKDTree

from dynamictree.errors import FormatError, InputError
from dynamictree.evaluation.procedural_wind import Bones
from dynamictree.mesh import TriangleMesh

ARRAYS = ("vertices", "rest", "faces", "part", "comp", "bone_head", "bone_tail", "bone_parent", "bone_names")
WOOD = 0  # in `part`


@dataclass(frozen=True, kw_only=True)
class SaplingTree:
    """One tree of Sapling with its motion."""

    name: str
    mesh: TriangleMesh
    displacement: Float32[np.ndarray, "T N 3"]  # from the rest pose [m]
    bones: Bones
    bone: Int32[np.ndarray, " N"]  # that a vertex goes with: the nearest of its own stem, or under its leaf


def sapling_files(folder: Path) -> list[Path]:
    """The trees in a folder, or in its folder `sapling`.

    Raises:
        InputError: there are none.
    """
    inner = folder / "sapling"
    files = sorted((inner if inner.is_dir() else folder).glob("*.npz"))
    if not files:
        raise InputError(f"there is no .npz of a Sapling tree in {folder} or {inner}; give the folder that holds them")
    return files


def read_sapling(path: Path) -> SaplingTree:
    """Read one tree.

    Raises:
        FormatError: an array is missing.
    """
    with np.load(path, allow_pickle=False) as baked:
        missing = [name for name in ARRAYS if name not in baked]
        if missing:
            raise FormatError(f"{path} lacks {', '.join(missing)}; a tree has the arrays {', '.join(ARRAYS)}")
        arrays = {name: baked[name] for name in ARRAYS}
    rest, comp, wood = arrays["rest"], arrays["comp"], arrays["part"] == WOOD
    bones = _bones(arrays, rest[wood], comp[wood])
    bone = np.zeros(len(rest), np.int32)
    middles = (bones.head + bones.tail) / 2
    for stem in np.unique(comp[wood]):
        vertices, rows = np.flatnonzero(wood & (comp == stem)), np.flatnonzero(bones.stem == stem)
        bone[vertices] = rows[cKDTree(middles[rows]).query(rest[vertices])[1]]
    for leaf in np.unique(comp[~wood]):
        vertices = np.flatnonzero(~wood & (comp == leaf))
        bone[vertices] = cKDTree(middles).query(rest[vertices].mean(axis=0))[1]
    return SaplingTree(
        name=path.stem,
        mesh=TriangleMesh(vertices=rest, faces=arrays["faces"]),
        displacement=arrays["vertices"] - rest,
        bones=bones,
        bone=bone,
    )


def _bones(
    arrays: dict[str, np.ndarray], wood: Float32[np.ndarray, "W 3"], stem_of_wood: Int32[np.ndarray, " W"]
) -> Bones:
    """Bones in the file's order, parents first; radii are those of the rings of vertices at their heads."""
    head, names = arrays["bone_head"], arrays["bone_names"]  # `boneSSS.NNN`: stem and step
    stem = np.array([int(name[4:7]) for name in names], np.int32)
    step = np.array([int(name[8:11]) for name in names], np.int32)
    rings = [
        np.sort(np.linalg.norm(wood[stem_of_wood == own] - at, axis=1))[:4] for own, at in zip(stem, head, strict=True)
    ]
    parent = arrays["bone_parent"].astype(np.int32)
    return Bones(
        head=head,
        tail=arrays["bone_tail"],
        parent=parent,
        stem=stem,
        step=step,
        radius=np.array([ring.mean() for ring in rings], np.float32),
        trunk=np.unique(stem[parent < 0]).astype(np.int32),
    )
