"""Select training trees by four rules on their motion. Paper appendix A, step 2."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32, Int32

from dynamictree.errors import InputError
from dynamictree.mesh import edges_of
from dynamictree.parallel import single_thread
from dynamictree.spectrum import FPS
from lab.dataset.limits import DatasetLimits
from lab.dataset.sample import Sample

Rule = Literal["high-frequency", "root-motion", "edge-stretch", "self-explosion"]


DEFAULT_LIMITS = DatasetLimits()


@dataclass(frozen=True, kw_only=True)
class Measures:
    """Measured values of a motion that the rules compare with limits."""

    high_frequency: float
    root_motion: float
    edge_stretch: float
    self_explosion: float

    def violated(self, limits: DatasetLimits) -> tuple[Rule, ...]:
        """Return the rules that this motion breaks; a non-finite measure breaks its rule."""
        checks: tuple[tuple[Rule, float, float], ...] = (
            ("high-frequency", self.high_frequency, limits.high_frequency),
            ("root-motion", self.root_motion, limits.root_motion),
            ("edge-stretch", self.edge_stretch, limits.edge_stretch),
            ("self-explosion", self.self_explosion, limits.self_explosion),
        )
        return tuple(rule for rule, value, allowed in checks if not value <= allowed)


def measure(sample: Sample, limits: DatasetLimits = DEFAULT_LIMITS, *, frame_step: int = 10) -> Measures:
    """Measure a sample: energies at its nodes in all frames, the rest at its vertices in every `frame_step`-th."""
    step = sample.motion.frames(np.arange(0, len(sample.motion.shift), frame_step))
    displacement = step.displacement(sample.mesh.vertices, sample.node)
    return Measures(
        high_frequency=high_frequency_energy(sample.motion.shift, fps=FPS, above_hz=limits.above_hz),
        root_motion=root_motion(sample.mesh.vertices, displacement),
        edge_stretch=edge_stretch(sample.mesh.vertices, sample.mesh.faces, displacement),
        self_explosion=float(np.linalg.norm(displacement, axis=2).max()) / sample.mesh.height_m,
    )


def high_frequency_energy(displacement: Float32[np.ndarray, "T N 3"], *, fps: float, above_hz: float) -> float:
    """Return the share of a motion's energy above `above_hz`, without the mean; 0 for a still tree."""
    frames = len(displacement)
    series = displacement.reshape(frames, -1)
    turn = np.exp(-2j * np.pi * np.outer(np.arange(frames // 2 + 1), np.arange(frames)) / frames)
    with single_thread():
        real, imaginary = turn.real.astype(np.float32) @ series, turn.imag.astype(np.float32) @ series
    power = (real**2 + imaginary**2).sum(axis=1)
    frequency_hz = np.fft.rfftfreq(frames, d=1 / fps)
    total = power[1:].sum()
    return float(power[frequency_hz > above_hz].sum() / total) if total != 0 else 0.0


def root_motion(vertices: Float32[np.ndarray, "N 3"], displacement: Float32[np.ndarray, "T N 3"]) -> float:
    """Return the largest displacement of vertices on the ground [share of the height]."""
    low, height = vertices[:, 2].min(), np.ptp(vertices[:, 2])
    on_ground = vertices[:, 2] <= low + 1e-4 * height
    return float(np.linalg.norm(displacement[:, on_ground], axis=2).max() / height)


def edge_stretch(
    vertices: Float32[np.ndarray, "N 3"],
    faces: Int32[np.ndarray, "F 3"],
    displacement: Float32[np.ndarray, "T N 3"],
    *,
    percentile: float = 99.9,
) -> float:
    """Return the relative change of edge lengths: a percentile over edges and frames."""
    first, second = edges_of(faces).T
    at_rest = vertices[first] - vertices[second]
    length = np.linalg.norm(at_rest, axis=1)
    moved = np.linalg.norm(at_rest + displacement[:, first] - displacement[:, second], axis=2)  # [T, E]
    return float(np.percentile(np.abs(moved / length - 1), percentile))


def rejections(verdicts: Iterable[tuple[str, ...]]) -> dict[str, int]:
    """Count the trees, the accepted ones, and the violations of each rule."""
    rules: Counter[str] = Counter(
        {"high-frequency": 0, "root-motion": 0, "edge-stretch": 0, "self-explosion": 0, "accepted": 0, "seen": 0}
    )
    for violated in verdicts:
        rules.update(["seen", *violated] if violated else ["seen", "accepted"])
    return dict(rules)


@dataclass(frozen=True, kw_only=True)
class MeasuredTree:
    """A tree that `generate` grew and measured, accepted or rejected."""

    seed: int
    species: str
    violated: tuple[str, ...]  # rules, by the limits of the run
    measures: Measures


def iter_measured(folder: Path) -> Iterator[MeasuredTree]:
    """Iterate over all measured trees, shard by shard; trees rejected in a review were not measured.

    Raises:
        InputError: the folder has no shard.
    """
    paths = sorted(folder.glob("4dtree-*.json"))
    if not paths:
        raise InputError(f"no shard lies in {folder}; bake one with `dynamictree dataset generate`")
    for path in paths:
        record = json.loads(path.read_bytes())
        yield from (_measured(tree["seed"], tree) for tree in record["trees"])
        yield from (_measured(int(seed), tree) for seed, tree in record["rejected"].items() if "measures" in tree)


def _measured(seed: int, tree: Mapping[str, Any]) -> MeasuredTree:
    return MeasuredTree(
        seed=seed, species=tree["species"], violated=tuple(tree.get("rules", ())), measures=Measures(**tree["measures"])
    )
