"""Read the records beside the shards, which describe the trees without loading them."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynamictree.errors import InputError
from lab.dataset.filter import Measures


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
