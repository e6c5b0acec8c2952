"""Generate a dataset shard by shard. The content of a shard depends only on its number and the recipe.

Shard i takes the trees that pass filter and review from the seeds `first_seed + i · 4 · trees_per_shard` on. Beside
each shard is a record (JSON) with its sha256. A shard with a matching record is not generated again, so interrupted
runs resume and machines can share the work. The manifest combines the records.
"""

import hashlib
import io
import json
import multiprocessing
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from dynamictree.errors import InputError
from lab.dataset.card import write_card
from lab.dataset.filter import DEFAULT_LIMITS, measure, rejections
from lab.dataset.limits import DatasetLimits
from lab.dataset.review import Verdict
from lab.dataset.sample import VERSION, make_sample
from lab.dataset.shards import StoredTree, stored_tree, write_shard

SEEDS_PER_TREE = 4  # a shard fails after so many seeds per wanted tree
PAPER_TREES = 8786  # number of trees in paper appendix A


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Parameters that determine the content of a dataset."""

    trees: int = PAPER_TREES  # number of accepted trees
    first_seed: int = 0
    trees_per_shard: int = 25
    resolutions: tuple[int, ...] = (128,)
    species: str | None = None  # the only species; by default drawn from the seeds
    limits: DatasetLimits = DEFAULT_LIMITS
    review: Mapping[int, Verdict] = field(default_factory=dict)

    @property
    def num_shards(self) -> int:
        """Number of shard files."""
        return -(-self.trees // self.trees_per_shard)

    def shard_seeds(self, index: int) -> range:
        """Range of seeds that a shard may use."""
        start = self.first_seed + index * SEEDS_PER_TREE * self.trees_per_shard
        return range(start, start + SEEDS_PER_TREE * self.trees_per_shard)

    def shard_trees(self, index: int) -> int:
        """Return the number of accepted trees in a shard; the last one may have fewer."""
        return min(self.trees_per_shard, self.trees - index * self.trees_per_shard)

    def of_shard(self, index: int) -> dict[str, object]:
        """Return everything that determines the bytes of one shard, with the types of JSON."""
        seeds = self.shard_seeds(index)
        decided = {
            "version": VERSION,
            "seeds": [seeds.start, seeds.stop],
            "trees": self.shard_trees(index),
            "resolutions": list(self.resolutions),
            "limits": self.limits.model_dump(),
            "review": {str(seed): self.review[seed] for seed in sorted(self.review) if seed in seeds},
        }
        return decided if self.species is None else {**decided, "species": self.species}


def shard_name(index: int) -> str:
    """Return a shard's file name without its suffix."""
    return f"4dtree-{index:05d}"


def generate(
    recipe: Recipe,
    folder: Path,
    *,
    workers: int = 1,
    part: tuple[int, int] = (0, 1),
    on_shard: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, object]:
    """Generate the missing shards, write the card and the manifest, and return it.

    The bytes do not depend on the number of processes (`workers`). `part` (i, n) is every n-th shard from the i-th on,
    one part per machine; `on_shard` receives the numbers of finished and wanted trees of it.

    Raises:
        InputError: the part does not exist, or too few trees pass the limits.
    """
    index, count = part
    if not 0 <= index < count:
        raise InputError(f"the part is {index}/{count}; 0/{count} to {count - 1}/{count} are allowed")
    folder.mkdir(parents=True, exist_ok=True)
    mine = range(index, recipe.num_shards, count)
    wanted = sum(recipe.shard_trees(shard) for shard in mine)
    missing = [shard for shard in mine if not is_baked(recipe, shard, folder)]
    done = wanted - sum(recipe.shard_trees(shard) for shard in missing)
    on_shard(done, wanted)
    for shard in _baking(recipe, missing, folder, workers):
        done += recipe.shard_trees(shard)
        on_shard(done, wanted)
    manifest = manifest_of(recipe, folder)
    _write(folder / "manifest.json", json.dumps(manifest, indent=1, sort_keys=True).encode())
    _write(folder / "README.md", write_card(manifest).encode())
    return manifest


def _baking(recipe: Recipe, missing: list[int], folder: Path, workers: int) -> Iterator[int]:
    """Generate shards in this process or in worker processes; yield the number of each finished shard."""
    if workers == 1:
        for shard in missing:
            bake_shard(recipe, shard, folder)
            yield shard
        return
    # a fork would copy locks of the threads of numba and BLAS
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=workers, mp_context=context, initializer=_end_with_parent) as pool:
        waiting = {pool.submit(bake_shard, recipe, shard, folder): shard for shard in missing}
        for future in as_completed(waiting):
            future.result()
            yield waiting[future]


def _end_with_parent() -> None:
    """End this worker process if its parent is killed."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def bake_shard(recipe: Recipe, index: int, folder: Path) -> None:
    """Generate one shard and its record."""
    trees: list[StoredTree] = []
    records: list[dict[str, object]] = []
    verdicts: list[tuple[str, ...]] = []
    rejected: dict[str, dict[str, object]] = {}
    for seed in recipe.shard_seeds(index):
        if len(trees) == recipe.shard_trees(index):
            break
        if recipe.review.get(seed) == "reject":
            verdicts.append(("curation",))
            rejected[str(seed)] = {"rules": ["curation"]}
            continue
        sample = make_sample(seed, recipe.species)
        measures = measure(sample, recipe.limits)
        violated = () if recipe.review.get(seed) == "accept" else measures.violated(recipe.limits)
        verdicts.append(violated)
        if violated:
            rejected[str(seed)] = {"rules": list(violated), "species": sample.species, "measures": asdict(measures)}
        else:
            tree = stored_tree(sample, resolutions=recipe.resolutions)
            trees.append(tree)
            records.append(
                {
                    "seed": sample.seed,
                    "species": sample.species,
                    "split": sample.split,
                    "vertices": sample.mesh.num_vertices,
                    "faces": sample.mesh.num_faces,
                    **{f"voxels_{size}": len(tree.tensors[f"r{size}.coords"]) for size in tree.grids},
                    "measures": asdict(measures),
                }
            )
    if len(trees) < recipe.shard_trees(index):
        raise InputError(
            f"only {len(trees)} of {len(verdicts)} trees of shard {index} passed the filter, "
            f"{recipe.shard_trees(index)} are needed; by rule: {rejections(verdicts)}; widen the limits"
        )
    content = io.BytesIO()
    write_shard(trees, content)
    _write(folder / f"{shard_name(index)}.safetensors", content.getvalue())
    record = {
        "file": f"{shard_name(index)}.safetensors",
        "sha256": hashlib.sha256(content.getvalue()).hexdigest(),
        "bytes": len(content.getvalue()),
        "recipe": recipe.of_shard(index),
        "trees": records,
        "rejected": rejected,
        "verdicts": rejections(verdicts),
    }
    _write(folder / f"{shard_name(index)}.json", json.dumps(record, sort_keys=True).encode())


def is_baked(recipe: Recipe, index: int, folder: Path) -> bool:
    """Return whether the folder has a shard generated by this recipe."""
    record, shard = folder / f"{shard_name(index)}.json", folder / f"{shard_name(index)}.safetensors"
    if not (record.exists() and shard.exists()):
        return False
    baked_record = json.loads(record.read_bytes())
    return bool(baked_record["recipe"] == recipe.of_shard(index) and baked_record["bytes"] == shard.stat().st_size)


def manifest_of(recipe: Recipe, folder: Path) -> dict[str, object]:
    """Combine the records in the folder; `complete` states whether all shards exist."""
    baked = [index for index in range(recipe.num_shards) if is_baked(recipe, index, folder)]
    records = [json.loads((folder / f"{shard_name(index)}.json").read_bytes()) for index in baked]
    verdicts: Counter[str] = Counter()
    for record in records:
        verdicts.update(record["verdicts"])
    trees = [tree for record in records for tree in record["trees"]]
    return {
        "format": "4dtree",
        "version": VERSION,
        "complete": len(baked) == recipe.num_shards,
        "trees": len(trees),
        "bytes": sum(record["bytes"] for record in records),
        "wanted": recipe.trees,
        "first_seed": recipe.first_seed,
        "trees_per_shard": recipe.trees_per_shard,
        "resolutions": list(recipe.resolutions),
        "only_species": recipe.species,
        "limits": recipe.limits.model_dump(),
        "reviewed": bool(recipe.review),
        "verdicts": dict(sorted(verdicts.items())),
        "species": dict(sorted(Counter(tree["species"] for tree in trees).items())),
        "splits": dict(sorted(Counter(tree["split"] for tree in trees).items())),
        "measures": {
            name: {
                label: float(np.percentile([tree["measures"][name] for tree in trees], at))
                for label, at in (("p50", 50), ("p99", 99), ("max", 100))
            }
            for name in (trees[0]["measures"] if trees else ())
        },
        "mean_vertices": round(sum(tree["vertices"] for tree in trees) / max(len(trees), 1), 1),
        "mean_voxels": {
            str(size): round(sum(tree[f"voxels_{size}"] for tree in trees) / max(len(trees), 1), 1)
            for size in recipe.resolutions
        },
        "shards": [
            {"file": record["file"], "sha256": record["sha256"], "trees": len(record["trees"])} for record in records
        ],
    }


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.write_bytes(content)
    unfinished.replace(path)
