"""A motion as GLB morph targets: the real and imaginary parts of the spectrum, weighted over time.

d_n = Re Σ_k w_k c_k e^{2πikn/T} = Re c_0 + Σ_{k≥1} w_k (cos(2πkn/T) Re c_k - sin(2πkn/T) Im c_k) is a constant and
2K - 2 parts m_i b_i with weights m_i in [-1, 1]. Players such as Blender clip weights to [0, 1], so each part becomes
a target 2 b_i of weight (1 + m_i) / 2, and the first target, of weight 1, is Re c_0 - Σ b_i. All weights 0, the
default, are the mesh at rest. 2K - 1 targets carry the motion, exact at every key. Engines need only support 8; the
reduced variant is the mean with the 7 parts that lose least.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import InputError
from dynamictree.formats.gltf.meshopt import compress
from dynamictree.formats.gltf.normals import NormalError, iter_normals, rest_normals
from dynamictree.formats.gltf.template import open_template
from dynamictree.formats.gltf.webp import webp_textures
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import FPS, NUM_FRAMES, bin_weights, iter_motion

REDUCED_TARGETS = 8
"""glTF 2.0, section 3.7.2.2: what every engine is asked to support."""


@dataclass(frozen=True, kw_only=True)
class MorphOptions:
    """What a file holds and how it is packed."""

    num_targets: int | None = None  # None is all 2K - 1; fewer are those with the least squared error
    with_normals: bool = False  # targets of normals as well, with the least squared error for the same weights
    compressed: bool = False  # by meshoptimizer; the summary's errors then count what that changes
    as_webp: bool = False  # textures become WebP where that is smaller
    fps: float = FPS  # keys a second of the file's time


@dataclass(frozen=True, kw_only=True)
class MorphSummary:
    """Summary of the file: number of targets, and the error of the reduction."""

    num_targets: int
    num_keys: int
    relative_error: float  # root mean square of what is missing over that of the motion
    rms_error_m: float  # over all vertices and frames
    max_error_m: float  # of any vertex at any frame


@dataclass(frozen=True, kw_only=True)
class ShadedMorphSummary(MorphSummary, NormalError):
    """Summary of a file whose targets also move normals."""


def write_motion_glb(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    stream: ByteWriter,
    *,
    num_frames: int = NUM_FRAMES,
    options: MorphOptions | None = None,
    truth: Callable[[], Iterator[Float32[np.ndarray, "N 3"]]] | None = None,
) -> MorphSummary:
    """Write one period with `num_frames` + 1 linear keys, the last equal to the first.

    A mesh that was read from glTF stays in its document, which gets targets and an animation, see `template.py`.
    `coefficients` are the spectrum of each vertex [m], `num_frames` is T.
    How far the file is from the frames of `truth`, by default those of the spectrum, it tells in its `asset.extras`.

    Raises:
        InputError: the number of targets is out of range, or meshoptimizer is not installed.
    """
    options, num_frequencies = options or MorphOptions(), coefficients.shape[1]
    num_targets = options.num_targets
    if num_targets is not None and not 1 <= num_targets <= 2 * num_frequencies - 1:
        raise InputError(f"num_targets is {num_targets}; 1 to {2 * num_frequencies - 1} are allowed for this spectrum")
    parts, moduli = loop_parts(coefficients, num_frames), loop_weights(num_frequencies, num_frames)
    few, few_moduli = _reduced(parts, moduli, num_targets or len(parts))
    phases = np.arange(num_frames) / num_frames
    targets = clipped_targets(few).reshape(len(few), -1, 3)
    moving = (targets != 0).any(axis=(0, 2))
    template = open_template(mesh)
    nodes, places = template.attach_targets(targets, moving if moving.any() else ~moving)
    weights = clipped_weights(few_moduli)
    if options.with_normals:
        error = template.attach_normals(
            rest_normals(mesh), lambda: iter_normals(mesh, iter_motion(coefficients, phases, num_frames)), weights
        )
    keys = np.concatenate([weights, weights[:1]]).astype(np.float32)  # [T + 1, targets]
    sway = template.add_sway(nodes, (np.arange(num_frames + 1) / options.fps).astype(np.float32), keys)
    sway["extras"] = {"num_vertices": mesh.num_vertices, "primitives": places}
    if options.as_webp:
        webp_textures(template.writer)
    change = None
    if options.compressed:
        change = template.changes(compress(template.writer), nodes, len(targets), mesh.num_vertices), weights
    exact = truth is None and few is parts and change is None
    frames = truth() if truth is not None else iter_motion(coefficients, phases, num_frames)
    share, rms, largest = (0.0, 0.0, 0.0) if exact else _distances(frames, few, few_moduli, change)
    summary = MorphSummary(
        num_targets=len(few), num_keys=num_frames + 1, relative_error=share, rms_error_m=rms, max_error_m=largest
    )
    if options.with_normals:
        summary = ShadedMorphSummary(**asdict(summary), **asdict(error))
    template.writer.extras = asdict(summary) | mesh.source.extras
    template.writer.finish(stream)
    return summary


def loop_parts(coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int) -> Float32[np.ndarray, "M N3"]:
    """Re c_0, then w_k Re c_k and w_k Im c_k of each further bin, as rows [m]."""
    by_bin = coefficients.transpose(1, 0, 2).reshape(coefficients.shape[1], -1)  # [K, 3N]
    by_bin = by_bin * bin_weights(len(by_bin), num_frames).astype(np.float32)[:, None]
    pairs = np.stack([by_bin.real, by_bin.imag], axis=1).reshape(2 * len(by_bin), -1)  # [2K, 3N]
    return np.ascontiguousarray(np.delete(pairs, 1, axis=0))


def loop_weights(
    num_frequencies: int, num_frames: int, turn: Float64[np.ndarray, " K"] | None = None
) -> Float64[np.ndarray, "T M"]:
    """Weight of each part at each frame, in [-1, 1], the first always 1; `turn` adds to each phase [rad]."""
    angle = 2 * np.pi * np.outer(np.arange(num_frames), np.arange(num_frequencies)) / num_frames  # [T, K]
    if turn is not None:
        angle = angle + turn
    pairs = np.stack([np.cos(angle), -np.sin(angle)], axis=2).reshape(num_frames, -1)
    return np.delete(pairs, 1, axis=1)


def clipped_targets(parts: Float32[np.ndarray, "M N3"]) -> Float32[np.ndarray, "M N3"]:
    """Targets that weights in [0, 1] move as `parts` with weights in [-1, 1] do; the first has weight 1."""
    targets = 2 * parts
    targets[0] = parts[0] - parts[1:].sum(axis=0, dtype=np.float64)
    return targets


def clipped_weights(weights: Float64[np.ndarray, "T M"]) -> Float64[np.ndarray, "T M"]:
    """Weights in [0, 1] for `clipped_targets`; the first column is 1."""
    clipped = (1 + weights) / 2
    clipped[:, 0] = 1
    return clipped


def _reduced(
    parts: Float32[np.ndarray, "M N3"], weights: Float64[np.ndarray, "T M"], count: int
) -> tuple[Float32[np.ndarray, "R N3"], Float64[np.ndarray, "T R"]]:
    """The mean with the best parts of that number (Eckart and Young 1936)."""
    if count == len(parts):
        return parts, weights
    swaying, swaying_weights = parts[1:], weights[:, 1:]
    values, vectors = np.linalg.eigh((swaying @ swaying.T).astype(np.float64))
    root = vectors * np.sqrt(np.maximum(values, 0))  # root rootᵀ is the Gram matrix
    u = np.linalg.svd(swaying_weights @ root, full_matrices=False)[0][:, : count - 1]
    largest = np.abs(u).max(axis=0, initial=0)  # weights then stay within -1 and 1
    best = (u.T @ swaying_weights).astype(np.float32) @ swaying * largest[:, None].astype(np.float32)
    return np.concatenate([parts[:1], best]), np.concatenate([weights[:, :1], u / largest], axis=1)


def _distances(
    frames: Iterator[Float32[np.ndarray, "N 3"]],
    parts: Float32[np.ndarray, "R N3"],
    weights: Float64[np.ndarray, "T R"],
    change: tuple[Float32[np.ndarray, "S N3"], Float64[np.ndarray, "T R"]] | None,
) -> tuple[float, float, float]:
    """How far parts are from frames: as a share of the motion, rms and largest [m].

    `change` is what a compression does to the rest pose and to each target, and the targets' weights.
    """
    total = squares = largest = 0.0
    for number, (frame, row) in enumerate(zip(frames, weights.astype(np.float32), strict=True)):
        gap = frame.ravel() - row @ parts
        if change is not None:
            gap = gap - change[0][0] - change[1][number].astype(np.float32) @ change[0][1:]
        lengths = (gap.reshape(-1, 3) ** 2).sum(axis=1)
        squares += float(lengths.sum(dtype=np.float64))
        largest = max(largest, float(lengths.max()))
        total += float((frame**2).sum(dtype=np.float64))
    rms = np.sqrt(squares / (len(weights) * parts.shape[1] / 3))
    return float(np.sqrt(squares / total)) if total > 0 else 0.0, float(rms), float(np.sqrt(largest))
