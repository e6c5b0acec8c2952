"""A motion as GLB morph targets: the real and imaginary parts of the spectrum, weighted over time.

d_n = Re Σ_k w_k c_k e^{2πikn/T} = Re c_0 + Σ_{k≥1} w_k (cos(2πkn/T) Re c_k - sin(2πkn/T) Im c_k) is a constant and
2K - 2 parts m_i b_i with weights m_i in [-1, 1]. Players such as Blender clip weights to [0, 1], so each part becomes
a target 2 b_i of weight (1 + m_i) / 2, and the first target, of weight 1, is Re c_0 - Σ b_i. All weights 0, the
default, are the mesh at rest. 2K - 1 targets carry the motion, exact at every key.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import FPS, NUM_FRAMES, bin_weights
from dynamictree.up_axis import up_rotation


@dataclass(frozen=True, kw_only=True)
class MorphSummary:
    """Summary of the file: number of targets, and their error against the frames."""

    num_targets: int
    num_keys: int
    relative_error: float  # root mean square of the error over that of the motion
    rms_error_m: float  # over all vertices and frames
    max_error_m: float  # largest error of any vertex at any frame


def write_motion_glb(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    stream: ByteWriter,
    *,
    num_frames: int = NUM_FRAMES,
    fps: float = FPS,
    truth: Callable[[], Iterator[Float32[np.ndarray, "N 3"]]] | None = None,
) -> MorphSummary:
    """Write one period with `num_frames` + 1 linear keys, the last equal to the first.

    `coefficients` are the spectrum of each vertex [m], `num_frames` is T, `fps` the keys per second of the file.
    Its `asset.extras` state the error against the frames of `truth`, by default those of the spectrum.
    """
    parts, moduli = loop_parts(coefficients, num_frames), loop_weights(coefficients.shape[1], num_frames)
    writer, rotation = GlbWriter(), up_rotation("+Y").astype(np.float32)
    targets = [
        {"POSITION": writer.add_accessor(target.reshape(-1, 3) @ rotation, target=VERTEX_BUFFER, bounds=True)}
        for target in clipped_targets(parts)
    ]
    add_mesh(writer, mesh, targets=targets)
    writer.append("nodes", {"mesh": 0, "name": "tree"})
    weights = clipped_weights(moduli)
    keys = np.concatenate([weights, weights[:1]]).astype(np.float32).reshape(-1, 1)
    times = (np.arange(num_frames + 1) / fps).astype(np.float32)
    clock = writer.add_accessor(times[:, None], bounds=True)
    sampler = {"input": clock, "output": writer.add_accessor(keys), "interpolation": "LINEAR"}
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    writer.append("animations", {"name": "sway", "samplers": [sampler], "channels": [channel]})
    share, rms, largest = (0.0, 0.0, 0.0) if truth is None else _distances(truth(), parts, moduli)
    summary = MorphSummary(
        num_targets=len(parts), num_keys=num_frames + 1, relative_error=share, rms_error_m=rms, max_error_m=largest
    )
    writer.extras = asdict(summary) | mesh.source.extras
    writer.finish(stream)
    return summary


def loop_parts(coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int) -> Float32[np.ndarray, "M N3"]:
    """Return Re c_0, then w_k Re c_k and w_k Im c_k of each further bin, as rows [m]."""
    by_bin = coefficients.transpose(1, 0, 2).reshape(coefficients.shape[1], -1)  # [K, 3N]
    by_bin = by_bin * bin_weights(len(by_bin), num_frames).astype(np.float32)[:, None]
    pairs = np.stack([by_bin.real, by_bin.imag], axis=1).reshape(2 * len(by_bin), -1)  # [2K, 3N]
    return np.ascontiguousarray(np.delete(pairs, 1, axis=0))


def loop_weights(
    num_frequencies: int, num_frames: int, turn: Float64[np.ndarray, " K"] | None = None
) -> Float64[np.ndarray, "T M"]:
    """Return each part's weight at each frame, in [-1, 1], the first always 1; `turn` adds to each phase [rad]."""
    angle = 2 * np.pi * np.outer(np.arange(num_frames), np.arange(num_frequencies)) / num_frames  # [T, K]
    if turn is not None:
        angle = angle + turn
    pairs = np.stack([np.cos(angle), -np.sin(angle)], axis=2).reshape(num_frames, -1)
    return np.delete(pairs, 1, axis=1)


def clipped_targets(parts: Float32[np.ndarray, "M N3"]) -> Float32[np.ndarray, "M N3"]:
    """Return targets whose weights are in [0, 1], for `parts` with weights in [-1, 1]; the first has weight 1."""
    targets = 2 * parts
    targets[0] = parts[0] - parts[1:].sum(axis=0, dtype=np.float64)
    return targets


def clipped_weights(weights: Float64[np.ndarray, "T M"]) -> Float64[np.ndarray, "T M"]:
    """Return weights in [0, 1] for `clipped_targets`; the first column is 1."""
    clipped = (1 + weights) / 2
    clipped[:, 0] = 1
    return clipped


def _distances(
    frames: Iterator[Float32[np.ndarray, "N 3"]],
    parts: Float32[np.ndarray, "M N3"],
    weights: Float64[np.ndarray, "T M"],
) -> tuple[float, float, float]:
    """Return the error of parts against frames: relative to the motion, root mean square [m] and largest [m]."""
    total = squares = largest = 0.0
    for frame, row in zip(frames, weights.astype(np.float32), strict=True):
        lengths = ((frame.ravel() - row @ parts).reshape(-1, 3) ** 2).sum(axis=1)
        squares += float(lengths.sum(dtype=np.float64))
        largest = max(largest, float(lengths.max()))
        total += float((frame**2).sum(dtype=np.float64))
    rms = np.sqrt(squares / (len(weights) * parts.shape[1] / 3))
    return float(np.sqrt(squares / total)) if total > 0 else 0.0, float(rms), float(np.sqrt(largest))
