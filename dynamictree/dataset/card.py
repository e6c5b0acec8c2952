"""The dataset card: what someone who finds the folder wants to know."""

from collections.abc import Mapping
from typing import Any

from dynamictree.dataset.species import SPECIES

_CARD = """# 4DTree, {trees:,} animated trees

Made by `dynamictree dataset generate` (generator version {version}); {state}. Every tree follows from its seed alone.

| | |
|---|---|
| trees | {trees:,} in {num_shards:,} shards, {gigabytes:.2f} GB |
| motion | one period of 100 frames at 24 fps, {loop}; the first 16 coefficients of the discrete Fourier transform |
| rest pose | the tree without wind: coefficient 0 is the lean |
| stored | mesh, part labels, skeleton, voxel spectrum at {resolutions}³ (float16){vertex_spectrum} |
| wind | speed 2 to 10 m/s, any direction, gust 0.15 to 0.45 of the speed; recorded with each tree |
| mean size | {mean_vertices:,.0f} vertices |
| splits | {splits} |

## How it was made

Branching after Weber and Penn (1995) with {num_species} species; key parameters (number of branches and leaves, height,
angles, thickness) are drawn widely, the others perturbed a little. Every stem is a damped oscillator that gusts and its
parent's motion drive. {seen:,} trees were made; the filter let {accepted:,} through.

| rule | rejected | share |
|---|---|---|
{rules}

| species | trees | |
|---|---|---|
{species}

## Reading it

`dynamictree.dataset.shards.iter_shard(path)`, or any safetensors reader: tensor `SEED/name`, the seed in seven digits;
names, shapes and units stand in that module. `manifest.json` holds each shard's sha256.

## What it is not

Procedural trees in a procedural wind: no measured trees, no collisions, no leaves that
break off, one wind for the whole tree.
"""


def write_card(manifest: Mapping[str, Any]) -> str:
    """The card of a manifest, in Markdown."""
    verdicts = manifest["verdicts"]
    seen = max(verdicts.get("seen", 0), 1)
    rules = "\n".join(
        f"| {rule} | {count:,} | {100 * count / seen:.2f} % |"
        for rule, count in verdicts.items()
        if rule not in ("seen", "accepted")
    )
    species = "\n".join(
        f"| {name} | {count:,} | {'never trained on' if SPECIES[name].held_out else ''} |"
        for name, count in manifest["species"].items()
    )
    return _CARD.format(
        trees=manifest["trees"],
        version=manifest["version"],
        state="complete" if manifest["complete"] else "not complete yet",
        num_shards=len(manifest["shards"]),
        gigabytes=manifest["bytes"] / 1e9,
        loop="which loops" if manifest["loop"] else "which does not loop",
        resolutions="³ and ".join(str(size) for size in manifest["resolutions"]),
        vertex_spectrum=", spectrum of every vertex (float16)" if manifest["vertex_spectrum"] else "",
        mean_vertices=manifest["mean_vertices"],
        splits=", ".join(f"{name} {count:,}" for name, count in manifest["splits"].items()),
        num_species=len(SPECIES),
        seen=verdicts.get("seen", 0),
        accepted=verdicts.get("accepted", 0),
        rules=rules,
        species=species,
    )
