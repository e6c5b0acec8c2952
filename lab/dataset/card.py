"""The dataset card: a Markdown description of a dataset folder."""

from collections.abc import Mapping
from typing import Any

from lab.dataset.species import SPECIES

_CARD = """# 4DTree, {trees:,} animated trees

Made by `dynamictree dataset generate` (generator version {version}); {state}. Every tree follows from its seed alone.

| | |
|---|---|
| trees | {trees:,} in {num_shards:,} shards, {gigabytes:.2f} GB |
| motion | one period of 100 frames at 24 fps, a loop; the first 16 coefficients of the discrete Fourier transform |
| rest pose | the tree without wind: coefficient 0 is the lean |
| stored | mesh, part labels, skeleton, voxel spectrum at {resolutions}³ (float16) |
| wind | speed 1 to 25 m/s (log-uniform), any direction, gust 0.15 to 0.45 of the speed; recorded with each tree |
| mean size | {mean_vertices:,.0f} vertices; {mean_voxels} |
| splits | {splits} |

## How it was made

Branching after Weber and Penn (1995) with {num_species} species; key parameters (number of branches and leaves, height,
angles, thickness) are drawn widely, the others perturbed a little. Every stem is a damped oscillator that gusts and its
parent's motion drive. {seen:,} trees were made; the filter let {accepted:,} through.

A tree may break several rules. The measures are those of the trees that were kept.

| rule | rejected | share | median | 99 % | largest | limit |
|---|---|---|---|---|---|---|
{rules}

High-frequency is the share of the motion's energy above 3 Hz; root motion and self-explosion are the largest
displacement of what stands on the ground, and of any vertex, over the height; edge stretch is the 99.9th percentile
over edges and frames.

| species | trees | |
|---|---|---|
{species}

## Reading it

`lab.dataset.shards.iter_shard(path)`, or any safetensors reader. Tensor `SEED/name`, the seed in seven digits:

| name | type and shape | |
|---|---|---|
| vertices, faces | float32 [N, 3], int32 [F, 3] | metres, +Z up, the trunk's foot near the origin |
| part | int8 [N] | level of the stem, 9 is a leaf |
| skeleton.position, .radius | float32 [B, 3], [B] | nodes, metres |
| skeleton.parent, .level, .stem | int32, int8, int32 [B] | parent −1 on the ground |
| skeleton.stem_length_m | float32 [S] | |
| r128.coords, .normals | int16 [V, 3], float16 [V, 3] | occupied voxels, centred at origin + (coords + ½) · size |
| r128.spectrum | float16 [V, 16, 3, 2] | real and imaginary parts, metres |

Displacement at frame n: Re Σ w_k c_k exp(2πi k n / 100), w_0 = 1, else 2. The metadata entry `4dtree` (JSON) holds
version, frames a second, and of each tree seed, species, split, wind and grids (by resolution: origin and voxel size,
metres). `manifest.json` holds each shard's sha256; beside each shard a JSON record tells sizes and filter measures
(`dynamictree dataset filter FOLDER`, `sheet FOLDER`).

## Making it again

    dynamictree dataset generate FOLDER {arguments}

gives the same bytes with any number of `--workers`, and shared among machines by `--shard i/n`.

## What it is not

Procedural trees in a procedural wind: no measured trees, no collisions, no leaves that
break off.
"""


def write_card(manifest: Mapping[str, Any]) -> str:
    """Return the card of a manifest, in Markdown."""
    verdicts = manifest["verdicts"]
    seen = max(verdicts.get("seen", 0), 1)
    rules = "\n".join(
        f"| {rule} | {count:,} | {100 * count / seen:.2f} % | {_spread(rule.replace('-', '_'), manifest)} |"
        for rule, count in verdicts.items()
        if rule not in ("seen", "accepted")
    )
    held_out = {species.name for species in SPECIES.values() if species.held_out}
    species = "\n".join(
        f"| {name} | {count:,} | {'never trained on' if name in held_out else ''} |"
        for name, count in manifest["species"].items()
    )
    return _CARD.format(
        trees=manifest["trees"],
        version=manifest["version"],
        state="complete" if manifest["complete"] else "not complete yet",
        num_shards=len(manifest["shards"]),
        gigabytes=manifest["bytes"] / 1e9,
        resolutions="³ and ".join(str(size) for size in manifest["resolutions"]),
        mean_vertices=manifest["mean_vertices"],
        mean_voxels=", ".join(f"{count:,.0f} voxels at {size}³" for size, count in manifest["mean_voxels"].items()),
        arguments=_arguments(manifest),
        splits=", ".join(f"{name} {count:,}" for name, count in manifest["splits"].items()),
        num_species=len(SPECIES),
        seen=verdicts.get("seen", 0),
        accepted=verdicts.get("accepted", 0),
        rules=rules,
        species=species,
    )


def _spread(measure: str, manifest: Mapping[str, Any]) -> str:
    """Format a measure's table columns; empty for a person's rules."""
    if measure not in manifest["measures"]:
        return "| | |"
    spread = manifest["measures"][measure]
    return " | ".join(f"{value:.2g}" for value in (*spread.values(), manifest["limits"][measure]))


def _arguments(manifest: Mapping[str, Any]) -> str:
    """Return the options of `generate` that determine the dataset's bytes."""
    arguments = [f"--trees {manifest['wanted']}", f"--first-seed {manifest['first_seed']}"]
    arguments += [f"--trees-per-shard {manifest['trees_per_shard']}"]
    arguments += [f"--resolution {size}" for size in manifest["resolutions"]]
    arguments += [f"--species {manifest['only_species']}"] * (manifest["only_species"] is not None)
    limits = {name: value for name, value in manifest["limits"].items() if name != "above_hz"}
    arguments += [f"--{name.replace('_', '-')} {value:g}" for name, value in limits.items()]
    return " ".join(arguments + ["--review FILE"] * manifest["reviewed"])
