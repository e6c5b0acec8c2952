"""Trees that Blender's Sapling add-on baked, as `.npz` of arrays: a motion that our generator did not make."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int32
from scipy.spatial import cKDTree

from dynamictree.errors import FormatError, InputError
from dynamictree.mesh import TriangleMesh
from lab.evaluation.procedural_wind import Bones

ARRAYS = ("vertices", "rest", "faces", "part", "comp", "bone_head", "bone_tail", "bone_parent", "bone_names")
OPTIONAL_ARRAYS = ("bone", "bone_mats")
WOOD = 0  # in `part`
NUM_CANDIDATES = 16
"""Nearest bones among which a leaf's own is searched. On 12 trees with 9,884 leaves it is the 13th nearest at most."""


@dataclass(frozen=True, kw_only=True)
class SaplingTree:
    """One tree of Sapling with its motion."""

    name: str
    mesh: TriangleMesh
    displacement: Float32[np.ndarray, "T N 3"]  # from the rest pose [m]
    bones: Bones
    bone: Int32[np.ndarray, " N"]  # that moves the vertex


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

    The file may state the `bone` of each vertex. Otherwise wood goes with the nearest bone of its stem, and a leaf with
    the nearby bone that moves as it does, or with the nearest bone where the file lacks the bones' motion, `bone_mats`.

    Raises:
        FormatError: an array is missing.
    """
    with np.load(path, allow_pickle=False) as baked:
        missing = [name for name in ARRAYS if name not in baked]
        if missing:
            raise FormatError(f"{path} lacks {', '.join(missing)}; a tree has the arrays {', '.join(ARRAYS)}")
        arrays = {name: baked[name] for name in (*ARRAYS, *OPTIONAL_ARRAYS) if name in baked}
    rest, wood = arrays["rest"], arrays["part"] == WOOD
    bones = _bones(arrays, rest[wood], arrays["comp"][wood])
    return SaplingTree(
        name=path.stem,
        mesh=TriangleMesh(vertices=rest, faces=arrays["faces"]),
        displacement=arrays["vertices"] - rest,
        bones=bones,
        bone=arrays["bone"] if "bone" in arrays else _bone_of_vertices(arrays, bones),
    )


def _bone_of_vertices(arrays: dict[str, np.ndarray], bones: Bones) -> Int32[np.ndarray, " N"]:
    rest, comp, wood = arrays["rest"], arrays["comp"], arrays["part"] == WOOD
    bone = np.zeros(len(rest), np.int32)
    middles = (bones.head + bones.tail) / 2
    for stem in np.unique(comp[wood]):
        vertices, rows = np.flatnonzero(wood & (comp == stem)), np.flatnonzero(bones.stem == stem)
        bone[vertices] = rows[cKDTree(middles[rows]).query(rest[vertices])[1]]
    for leaf in np.unique(comp[~wood]):
        vertices = np.flatnonzero(~wood & (comp == leaf))
        distance = np.linalg.norm(middles - rest[vertices].mean(axis=0), axis=1)
        nearest = np.argsort(distance)[:NUM_CANDIDATES]
        best = 0
        if "bone_mats" in arrays:
            best = _best_motion(arrays["bone_mats"][:, nearest], rest[vertices], arrays["vertices"][:, vertices])
        bone[vertices] = nearest[best]
    return bone


def _best_motion(
    mats: Float32[np.ndarray, "T M 4 4"], rest: Float32[np.ndarray, "L 3"], moved: Float32[np.ndarray, "T L 3"]
) -> int:
    """Which of M rigid motions takes a leaf's vertices nearest to where they move."""
    carried = np.einsum("tmij,lj->tmli", mats[..., :3, :3], rest) + mats[..., None, :3, 3]  # [T, M, L, 3]
    return int(np.square(carried - moved[:, None]).sum(axis=(0, 2, 3)).argmin())


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
