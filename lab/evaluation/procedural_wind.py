"""Procedural wind after Weber and Penn (1995), section 4.4, as in Blender's Sapling add-on: a baseline.

It needs a skeleton, which a scan does not have. Written from the formulas; bakes of the add-on are the reference in
`tests/lab/evaluation/test_procedural_wind.py`. Each bone turns about its head, in its own axes, by two sinusoids of its
stem's own frequency and a gust that all stems share; what hangs on the bone follows it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32
from scipy.spatial import cKDTree

from dynamictree.spectrum import FPS, NUM_FRAMES
from lab.dataset.sapling import Tree
from lab.dataset.stem_skeleton import Skeleton, skeleton_of

WIND_BLOWS_TO_DEG = -90.0
"""The add-on's wind blows along −Y."""
GUST_HZ = 0.075
STILL_TRUNK_BONES = 2
MIN_RADIUS_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class Bones:
    """A skeleton, parents before children."""

    head: Float32[np.ndarray, "B 3"]  # [m]
    tail: Float32[np.ndarray, "B 3"]  # [m]
    parent: Int32[np.ndarray, " B"]  # -1 on the ground
    stem: Int32[np.ndarray, " B"]
    step: Int32[np.ndarray, " B"]  # place in its stem, from 0; -1 for a bone that only joins a stem to its parent's
    radius: Float32[np.ndarray, " B"]  # at the head [m]
    trunk: Int32[np.ndarray, " M"]  # the stems that stand on the ground


@dataclass(frozen=True, kw_only=True)
class BoneMotion:
    """Every bone's rigid motion at every frame: x goes to turn x + shift."""

    turn: Float32[np.ndarray, "T B 3 3"]
    shift: Float32[np.ndarray, "T B 3"]  # [m]

    def displacement(
        self, vertices: Float32[np.ndarray, "N 3"], bone: Int32[np.ndarray, " N"]
    ) -> Float32[np.ndarray, "T N 3"]:
        """Displacement of vertices, each with its bone [m]."""
        frames = zip(self.turn, self.shift, strict=True)
        return np.stack(
            [np.einsum("nxy,ny->nx", turn[bone], vertices) + shift[bone] - vertices for turn, shift in frames]
        )


def bones_of(tree: Tree) -> tuple[Bones, Int32[np.ndarray, " N"]]:
    """A dataset tree's bones, one a node of its skeleton, and the bone of each vertex; a leaf goes with its twig."""
    skeleton = skeleton_of(tree.stems)
    bones = _bones(skeleton)
    count = len(skeleton.position)
    holds = np.concatenate([leaves.base for leaves in tree.leaves]) if tree.leaves else np.zeros((0, 3))
    twig = cKDTree(skeleton.position).query(holds)[1] if len(holds) else np.zeros(0, np.int64)
    return bones, np.concatenate([np.arange(count), twig])[tree.node].astype(np.int32)


def sway_as_sapling(
    bones: Bones,
    rng: np.random.Generator,
    *,
    wind: float = 1.0,
    gust: float = 1.0,
    loop: bool = True,
    num_frames: int = NUM_FRAMES,
) -> BoneMotion:
    """Move a skeleton.

    Args:
        bones: whose.
        rng: draws two phases a stem.
        wind: strength on the add-on's own scale; 1 is its default.
        gust: of the wind; 1 is the add-on's default.
        loop: round every frequency to the period's, as the add-on does when its loop option is set.
        num_frames: of 1/24 s.
    """
    around_x, around_z = local_angles(bones, rng, wind=wind, gust=gust, loop=loop, num_frames=num_frames)
    cx, sx, cz, sz = np.cos(around_x), np.sin(around_x), np.cos(around_z), np.sin(around_z)
    zero = np.zeros_like(cx)
    local = np.stack([cz, -sz * cx, sz * sx, sz, cz * cx, -cz * sx, zero, sx, cx], axis=-1)  # Rz Rx
    axes = rest_axes(bones)
    turned = np.einsum("bij,tbjk,blk->tbil", axes, local.reshape(*cx.shape, 3, 3), axes)  # [T, B, 3, 3]
    turn = np.empty_like(turned)
    shift = np.empty(turned.shape[:3])
    for bone, above in enumerate(bones.parent):
        head = bones.head[bone].astype(np.float64)
        turn[:, bone] = turned[:, bone] if above < 0 else turn[:, above] @ turned[:, bone]
        place = head if above < 0 else turn[:, above] @ head + shift[:, above]
        shift[:, bone] = place - turn[:, bone] @ head
    return BoneMotion(turn=turn.astype(np.float32), shift=shift.astype(np.float32))


def local_angles(
    bones: Bones, rng: np.random.Generator, *, wind: float, gust: float, loop: bool, num_frames: int
) -> tuple[Float64[np.ndarray, "T B"], Float64[np.ndarray, "T B"]]:
    """Turns about each bone's own X and Z [rad]."""
    length, size = bend(bones)
    first = size * wind / 50
    gusting = size * wind * gust / 50
    fast = 1 / (4 * np.sqrt(length))  # [rad / frame]
    slow, gusts = 0.7 * fast, np.full_like(fast, 2 * np.pi * GUST_HZ / FPS)
    if loop:
        unit = 2 * np.pi / num_frames
        fast, slow = (np.maximum(1, np.round(omega / unit)) * unit for omega in (fast, slow))
        gusts = np.full_like(fast, unit)
    phases = rng.uniform(0, 2 * np.pi, (int(bones.stem.max()) + 1, 2))[bones.stem]  # [B, 2]
    time = np.arange(num_frames)[:, None]
    blowing = gusting * (np.sin(gusts * time) + 0.6)
    along = _directions(bones)
    angles = [
        first * np.sin(fast * time + phase) + 0.65 * first * np.sin(slow * time + 0.7 * phase) + sign * blowing
        for phase, sign in zip(phases.T, (along[:, 2], -along[:, 0]), strict=True)
    ]
    return angles[0], angles[1]


def bend(bones: Bones) -> tuple[Float64[np.ndarray, " B"], Float64[np.ndarray, " B"]]:
    """Length of each bone's stem [m], and how far the bone bends [rad]: 2 (L / P) (1 − n / (P + 1)) / r degrees.

    As in the add-on, the length L is the number of bones P times the first one's, whatever the others' are.
    """
    moving, first = bones.step >= 0, bones.step == 0
    number = np.bincount(bones.stem[moving], minlength=int(bones.stem.max()) + 1)
    length = np.zeros(len(number))
    length[bones.stem[first]] = np.linalg.norm(bones.tail - bones.head, axis=1)[first]
    length *= number
    of_bone, count = np.maximum(length, 1e-3)[bones.stem], np.maximum(number, 1)[bones.stem]
    place = 1 - bones.step / (count + 1)
    size = np.deg2rad(2 * of_bone / count * place / np.maximum(bones.radius, MIN_RADIUS_M))
    still = ~moving | (np.isin(bones.stem, bones.trunk) & (bones.step < STILL_TRUNK_BONES))
    return of_bone, np.where(still, 0, size)


def rest_axes(bones: Bones) -> Float64[np.ndarray, "B 3 3"]:
    """Each bone's own axes as columns: Y along it, the others by the shortest turn from the world's."""
    x, y, z = _directions(bones).T
    down = y < -1 + 1e-9  # no shortest turn; any will do
    cosine = np.where(down, 0, y)
    share = 1 / (1 + cosine)
    columns = [
        [1 - x * x * share, x, -x * z * share],
        [-x, cosine, -z],
        [-x * z * share, z, 1 - z * z * share],
    ]
    axes = np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in columns], axis=1)
    axes[down] = np.diag([1.0, -1.0, -1.0])
    return axes


def _directions(bones: Bones) -> Float64[np.ndarray, "B 3"]:
    along = (bones.tail - bones.head).astype(np.float64)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.where(length > 0, along, [0.0, 0.0, 1.0])
    directions: Float64[np.ndarray, "B 3"] = along / np.where(length > 0, length, 1)
    return directions


def _bones(skeleton: Skeleton) -> Bones:
    """A bone from each node's parent to it; one that leads to a stem's base only joins it to what bears it.

    At a fork that bone has no length, as the new stem's first ring is also a ring of the stem that divides.
    """
    position, parent, level, stem = skeleton.position, skeleton.parent, skeleton.level, skeleton.stem
    above = np.where(parent < 0, np.arange(len(parent)), parent)
    own = (position != position[above]).any(axis=1) & (level[above] == level)
    begins = np.r_[True, stem[1:] != stem[:-1]]
    rank = np.arange(len(stem)) - np.maximum.accumulate(np.where(begins, np.arange(len(stem)), 0))
    joined = begins & ~own
    step = np.where(joined, -1, rank - joined[np.maximum.accumulate(np.where(begins, np.arange(len(stem)), 0))])
    return Bones(
        head=position[above],
        tail=position,
        parent=parent.astype(np.int32),
        stem=stem.astype(np.int32),
        step=step.astype(np.int32),
        radius=np.where(own, skeleton.radius[above], skeleton.radius).astype(np.float32),
        trunk=np.unique(stem[parent < 0]).astype(np.int32),
    )
