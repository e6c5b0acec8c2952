"""Read the records beside the shards, which describe the trees without loading them."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynamictree.errors import FormatError, InputError
from lab.dataset.filter import Measures
from lab.dataset.stats import StemTable, table_of


@dataclass(frozen=True, kw_only=True)
class SeenTree:
    """A tree that `generate` made and measured, accepted or rejected."""

    seed: int
    species: str
    broken: tuple[str, ...]  # rules, by the limits of the bake
    measures: Measures
    stems: StemTable | None  # of accepted trees


def iter_seen(folder: Path) -> Iterator[SeenTree]:
    """Every tree that was measured, shard by shard; those that a review rejected were not.

    Raises:
        InputError: no shard lies in the folder.
        FormatError: a shard was baked before records had measures.
    """
    for path in _records(folder):
        record = json.loads(path.read_bytes())
        yield from (_accepted_tree(tree, path) for tree in record["trees"])
        for seed, tree in record["rejected"].items():
            if "measures" in tree:
                yield SeenTree(
                    seed=int(seed),
                    species=tree["species"],
                    broken=tuple(tree["rules"]),
                    measures=Measures(**tree["measures"]),
                    stems=None,
                )


def _records(folder: Path) -> list[Path]:
    manifests = sorted(folder.glob("4dtree-*.json"))
    if not manifests:
        raise InputError(f"no shard lies in {folder}; bake one with `dynamictree dataset generate`")
    return manifests


def _accepted_tree(tree: Mapping[str, Any], path: Path) -> SeenTree:
    if "measures" not in tree:
        raise FormatError(f"{path} has no measures: an earlier version baked it; remove it and generate again")
    return SeenTree(
        seed=tree["seed"],
        species=tree["species"],
        broken=(),
        measures=Measures(**tree["measures"]),
        stems=table_of(tree["species"], tree["stems"]),
    )
