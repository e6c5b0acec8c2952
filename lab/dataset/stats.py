"""Statistics of a dataset's stems: lengths, radii, frequencies and amplitudes by level."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Int8, Int32

from dynamictree.byte_stream import ByteWriter
from dynamictree.spectrum import FPS, NUM_FREQUENCIES
from lab.dataset.sample import Sample

MEASURED = ("length_m", "radius_m", "frequency_hz", "amplitude_rad")


@dataclass(frozen=True, kw_only=True)
class StemTable:
    """One row per stem or per level, and values of the whole tree."""

    level: Int8[np.ndarray, " S"]
    length_m: Float32[np.ndarray, " S"]
    radius_m: Float32[np.ndarray, " S"]  # at the base
    frequency_hz: Float32[
        np.ndarray, " S"
    ]  # where the tip's turning against the base is fastest; 0 if it does not turn
    amplitude_rad: Float32[np.ndarray, " S"]  # root mean square of that turning
    count: Int32[np.ndarray, " S"]  # stems that a row stands for, as their median
    height_m: float
    species: str
    wind_speed_m_s: float
    first_bins_share: float  # of the displacement's energy, the mean included


def tables_of(sample: Sample) -> StemTable:
    """Measure one tree."""
    skeleton = sample.skeleton
    num_nodes = len(skeleton.position)
    tip = np.zeros(len(skeleton.stem_length_m), np.int64)
    tip[skeleton.stem] = np.arange(num_nodes)  # a stem's last node stands last
    base = np.zeros_like(tip)
    base[skeleton.stem[::-1]] = np.arange(num_nodes)[::-1]
    hanging = skeleton.parent[base]
    turn = sample.motion.turn + np.eye(3, dtype=np.float32)
    frequency_hz, amplitude_rad = bending(turn[:, np.where(hanging < 0, base, hanging)], turn[:, tip])
    return StemTable(
        level=skeleton.level[base],
        length_m=skeleton.stem_length_m,
        radius_m=skeleton.radius[base],
        frequency_hz=frequency_hz,
        amplitude_rad=amplitude_rad,
        count=np.ones(len(tip), np.int32),
        height_m=sample.mesh.height_m,
        species=sample.species,
        wind_speed_m_s=sample.wind.speed_m_s,
        first_bins_share=first_bins_share(sample.motion.shift),
    )


def table_facts(table: StemTable) -> dict[str, object]:
    """A table as JSON, the median of each level. Undone by `table_of`, but for the stems' own values."""
    levels = [np.flatnonzero(table.level == depth) for depth in range(int(table.level.max()) + 1)]
    columns = {name: [round(float(np.median(getattr(table, name)[rows])), 6) for rows in levels] for name in MEASURED}
    return {
        "count": [len(rows) for rows in levels],
        **columns,
        "height_m": round(table.height_m, 4),
        "first_bins_share": round(table.first_bins_share, 9),
        "wind_speed_m_s": table.wind_speed_m_s,
    }


def table_of(species: str, facts: Mapping[str, Any]) -> StemTable:
    """The table of `table_facts`: a row a level."""
    return StemTable(
        level=np.arange(len(facts["count"]), dtype=np.int8),
        count=np.array(facts["count"], np.int32),
        **{name: np.array(facts[name], np.float32) for name in MEASURED},
        height_m=facts["height_m"],
        species=species,
        wind_speed_m_s=facts["wind_speed_m_s"],
        first_bins_share=facts["first_bins_share"],
    )


def bending(
    base: Float32[np.ndarray, "T S 3 3"], tip: Float32[np.ndarray, "T S 3 3"], *, fps: float = FPS
) -> tuple[Float32[np.ndarray, " S"], Float32[np.ndarray, " S"]]:
    """Frequency [Hz] and amplitude [rad] of the tip's turning against the base, from rotations."""
    relative = np.einsum("tsji,tsjk->tsik", base, tip)
    vector = np.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        axis=-1,
    ) / 2  # of small angles, the rotation vector  # fmt: skip
    power = (np.abs(np.fft.rfft(vector, axis=0, norm="forward")) ** 2).sum(axis=2)  # [T // 2 + 1, S]
    frequency = np.fft.rfftfreq(len(vector), d=1 / fps)
    fastest = (power * frequency[:, None] ** 2).argmax(axis=0)
    amplitude = np.sqrt(2 * power[1:].sum(axis=0))
    return frequency[fastest].astype(np.float32), amplitude.astype(np.float32)


def first_bins_share(displacement: Float32[np.ndarray, "T N 3"], num_frequencies: int = NUM_FREQUENCIES) -> float:
    """Share of a motion's energy that its first K coefficients hold."""
    power = (np.abs(np.fft.rfft(displacement, axis=0)) ** 2).sum(axis=(1, 2))
    power[1:] *= 2
    return float(power[:num_frequencies].sum() / power.sum())


def numbers_of(tables: Sequence[StemTable]) -> dict[str, object]:
    """Medians by level and over trees."""
    level = np.concatenate([table.level for table in tables])
    count = np.concatenate([table.count for table in tables])
    columns = {name: np.concatenate([getattr(table, name) for table in tables]) for name in MEASURED}
    heights = [table.height_m for table in tables]
    return {
        "trees": len(tables),
        "height_m": {name: float(np.percentile(heights, at)) for name, at in (("p5", 5), ("p50", 50), ("p95", 95))},
        "first_bins_share": float(np.median([table.first_bins_share for table in tables])),
        "levels": {
            str(depth): {
                "stems_a_tree": float(count[level == depth].sum() / len(tables)),
                **{name: float(np.median(column[level == depth])) for name, column in columns.items()},
            }
            for depth in range(int(level.max()) + 1)
        },
    }


def draw_plots(tables: Sequence[StemTable], stream: ByteWriter) -> None:
    """Four plots as one PNG: heights, lengths by level, frequency and amplitude against length."""
    from matplotlib.figure import Figure
    from PIL import Image

    whole = all((table.count == 1).all() for table in tables)
    of_stem = "stem length [m]" if whole else "stem length [m], median of each tree and level"

    figure = Figure(figsize=(12, 9), layout="constrained")
    heights, lengths, frequencies, amplitudes = figure.subplots(2, 2).ravel()
    names = sorted({table.species for table in tables})
    by_species = [[table.height_m for table in tables if table.species == name] for name in names]
    heights.boxplot(by_species, orientation="horizontal", tick_labels=names)
    heights.set_xlabel("height [m]")
    level = np.concatenate([table.level for table in tables])
    length = np.concatenate([table.length_m for table in tables])
    lengths.hist(
        [length[level == depth] for depth in range(level.max() + 1)],
        bins=list(np.geomspace(max(length.min(), 1e-2), length.max(), 30)),
        stacked=True,
        label=[f"level {depth}" for depth in range(level.max() + 1)],
    )
    lengths.set_xscale("log")
    lengths.set_xlabel(of_stem)
    lengths.legend()
    columns = (
        (frequencies, "frequency_hz", "frequency of bending [Hz]"),
        (amplitudes, "amplitude_rad", "bending, root mean square [rad]"),
    )
    for axes, name, title in columns:
        values = np.concatenate([getattr(table, name) for table in tables])
        for depth in range(level.max() + 1):
            chosen = (level == depth) & (values > 0)
            axes.scatter(length[chosen], values[chosen], s=3, alpha=0.3, label=f"level {depth}")
        axes.set(xscale="log", yscale="log", xlabel=of_stem, ylabel=title)
        axes.legend()
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=100)
    small = io.BytesIO()
    Image.open(content).convert("RGB").quantize(64).save(small, format="png", optimize=True)
    stream.write(small.getvalue())
