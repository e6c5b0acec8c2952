"""A motion as GLB morph targets: the real and imaginary parts of the spectrum, weighted over time.

d_n = Re Σ_k w_k c_k e^{2πikn/T} = Re c_0 + Σ_{k≥1} w_k (cos(2πkn/T) Re c_k - sin(2πkn/T) Im c_k), so that 2K - 1
targets carry the motion, exact at every key. Engines need only support 8; the reduced variant is the best of 8.
"""

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import InputError
from dynamictree.formats.axes import up_rotation
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import FPS, NUM_FRAMES, bin_weights

REDUCED_TARGETS = 8
"""glTF 2.0, section 3.7.2.2: what every engine is asked to support."""


@dataclass(frozen=True, kw_only=True)
class MorphSummary:
    """What was written, and what reducing it cost."""

    num_targets: int
    num_keys: int
    relative_error: float  # root mean square of what is missing over that of the motion
    rms_error_m: float  # over all vertices and frames
    max_error_m: float  # of any vertex at any frame


def write_motion_glb(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    stream: ByteWriter,
    *,
    num_frames: int = NUM_FRAMES,
    fps: float = FPS,
    num_targets: int | None = None,
) -> MorphSummary:
    """Write one period with `num_frames` + 1 linear keys, the last equal to the first.

    `coefficients` are the spectrum of each vertex [m], `num_frames` is T, `fps` the keys a second of the file's time.
    `num_targets=None` writes all 2K - 1; fewer are chosen so that the squared error is the least possible, which the
    file tells in its `asset.extras`.

    Raises:
        InputError: the number of targets is out of range.
    """
    num_frequencies = coefficients.shape[1]
    if num_targets is not None and not 1 <= num_targets <= 2 * num_frequencies - 1:
        raise InputError(f"num_targets is {num_targets}; 1 to {2 * num_frequencies - 1} are allowed for this spectrum")
    basis, weights = morph_targets(coefficients), key_weights(num_frequencies, num_frames)
    whole, all_weights = basis, weights
    basis, weights, (total, missing) = _reduced(whole, all_weights, num_targets or len(whole))
    summary = MorphSummary(
        num_targets=len(basis),
        num_keys=num_frames + 1,
        relative_error=float(np.sqrt(missing / total)) if total > 0 else 0.0,
        rms_error_m=float(np.sqrt(missing / (num_frames * len(coefficients)))),
        max_error_m=_furthest(whole, all_weights, basis, weights),
    )
    writer = GlbWriter(extras=asdict(summary))
    rotation = up_rotation("+Y").astype(np.float32)
    accessors = [
        {"POSITION": writer.add_accessor(target.reshape(-1, 3) @ rotation, target=VERTEX_BUFFER, bounds=True)}
        for target in basis
    ]
    add_mesh(writer, mesh, targets=accessors)
    keys = np.concatenate([weights, weights[:1]]).astype(np.float32)  # [T + 1, targets]
    times = (np.arange(num_frames + 1) / fps).astype(np.float32)
    sampler = {
        "input": writer.add_accessor(times[:, None], bounds=True),
        "output": writer.add_accessor(keys.reshape(-1, 1)),
        "interpolation": "LINEAR",
    }
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    writer.append("nodes", {"mesh": 0, "name": "tree"})
    writer.append("animations", {"name": "sway", "samplers": [sampler], "channels": [channel]})
    writer.finish(stream)
    return summary


def morph_targets(coefficients: Complex64[np.ndarray, "N K 3"]) -> Float32[np.ndarray, "M N3"]:
    """Re c_0, then Re and Im of each further bin, as rows."""
    by_bin = coefficients.transpose(1, 0, 2).reshape(coefficients.shape[1], -1)  # [K, 3N]
    pairs = np.stack([by_bin.real, by_bin.imag], axis=1).reshape(2 * len(by_bin), -1)  # [2K, 3N]
    return np.ascontiguousarray(np.delete(pairs, 1, axis=0))


def key_weights(
    num_frequencies: int, num_frames: int, turn: Float64[np.ndarray, " K"] | None = None
) -> Float64[np.ndarray, "T M"]:
    """How far each target is on at each frame; `turn` adds to the phase of each frequency [rad]."""
    k = np.arange(num_frequencies)
    angle = 2 * np.pi * np.outer(np.arange(num_frames), k) / num_frames  # [T, K]
    if turn is not None:
        angle = angle + turn
    w = bin_weights(num_frequencies, num_frames)
    pairs = np.stack([w * np.cos(angle), -w * np.sin(angle)], axis=2).reshape(num_frames, -1)
    return np.delete(pairs, 1, axis=1)


def _reduced(
    basis: Float32[np.ndarray, "M N3"], weights: Float64[np.ndarray, "T M"], count: int
) -> tuple[Float32[np.ndarray, "R N3"], Float64[np.ndarray, "T R"], tuple[float, float]]:
    """The best targets and weights of that rank (Eckart and Young 1936); squared sums of the motion and the loss."""
    gram = (basis @ basis.T).astype(np.float64)
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0))  # gram = root rootᵀ
    u, s, _ = np.linalg.svd(weights @ root, full_matrices=False)
    total = float((s**2).sum())
    if count == len(basis):
        return basis, weights, (total, 0.0)
    targets = (u[:, :count].T @ weights).astype(np.float32) @ basis
    scale = np.abs(u[:, :count]).max(axis=0)  # weights then stay within -1 and 1
    return targets * scale[:, None].astype(np.float32), u[:, :count] / scale, (total, float((s[count:] ** 2).sum()))


def _furthest(
    basis: Float32[np.ndarray, "M N3"],
    weights: Float64[np.ndarray, "T M"],
    few: Float32[np.ndarray, "R N3"],
    few_weights: Float64[np.ndarray, "T R"],
) -> float:
    """The largest distance between the same vertex at the same frame, with all targets and with a few [m]."""
    if few is basis:
        return 0.0
    largest = 0.0
    for row, few_row in zip(weights.astype(np.float32), few_weights.astype(np.float32), strict=True):
        gap = (row @ basis - few_row @ few).reshape(-1, 3)
        largest = max(largest, float((gap**2).sum(axis=1).max()))
    return float(np.sqrt(largest))
