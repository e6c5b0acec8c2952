"""Shards: safetensors files of several trees each; the same seeds give the same bytes.

Tensors of tree SEED are named `SEED/name`, the seed in seven digits or more:

    vertices float32 [N, 3] (m) · faces int32 [F, 3] · part int8 [N] (stem level, 9 is leaf)
    skeleton.position, .radius, .parent, .level, .stem, .stem_length_m
    r128.coords int16 [V, 3] · r128.normals float16 [V, 3] · r128.spectrum float16 [V, K, 3, 2] (re, im; m), and so on

The only metadata entry, `4dtree`, is JSON: version, fps, num_frames, and per tree seed, species, split, wind, grids.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import safetensors.numpy
from jaxtyping import Complex64, Float16

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import FormatError
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import FPS, NUM_FRAMES, SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels
from lab.dataset.sample import VERSION, Sample, Split, voxel_spectrum
from lab.dataset.stem_skeleton import Skeleton

METADATA = "4dtree"


@dataclass(frozen=True, kw_only=True)
class StoredTree:
    """One tree in a shard; its mesh is read on demand."""

    seed: int
    species: str
    split: Split
    wind: Wind
    tensors: dict[str, np.ndarray]
    grids: dict[int, tuple[tuple[float, float, float], float]]  # resolution: origin and voxel size [m]

    def voxels(self, resolution: int = 128) -> SurfaceVoxels:
        """Return the occupied voxels with normals, at one of the stored resolutions."""
        origin_m, voxel_size_m = self.grids[resolution]
        grid = VoxelGrid(
            coords=self.tensors[f"r{resolution}.coords"].astype(np.int32),
            origin_m=origin_m,
            voxel_size_m=voxel_size_m,
            resolution=resolution,
        )
        return SurfaceVoxels(grid=grid, normals=self.tensors[f"r{resolution}.normals"].astype(np.float32))

    def mesh(self) -> TriangleMesh:
        """Return the mesh: vertices and faces."""
        return TriangleMesh(vertices=self.tensors["vertices"], faces=self.tensors["faces"])

    def spectrum(self, resolution: int = 128) -> SparseVoxelSpectrum:
        """Return the spectrum of the motion, at one of the stored resolutions."""
        return SparseVoxelSpectrum(
            grid=self.voxels(resolution).grid,
            coefficients=from_half(self.tensors[f"r{resolution}.spectrum"]),
            model=f"{METADATA}-{VERSION}",
            seed=self.seed,
            wind=self.wind,
        )

    def skeleton(self) -> Skeleton:
        """Return the skeleton: nodes and their parents."""
        fields = ("position", "radius", "parent", "level", "stem", "stem_length_m")
        return Skeleton(**{name: self.tensors[f"skeleton.{name}"] for name in fields})


def to_half(coefficients: Complex64[np.ndarray, "N K 3"]) -> Float16[np.ndarray, "N K 3 2"]:
    """Convert complex values to float16 (re, im)."""
    pairs = np.ascontiguousarray(coefficients).view(np.float32).reshape(*coefficients.shape, 2)
    return pairs.astype(np.float16)


def from_half(pairs: Float16[np.ndarray, "N K 3 2"]) -> Complex64[np.ndarray, "N K 3"]:
    """Undo `to_half`, up to float16."""
    return np.ascontiguousarray(pairs.astype(np.float32)).view(np.complex64)[..., 0]


def stored_tree(sample: Sample, *, resolutions: tuple[int, ...]) -> StoredTree:
    """Convert a sample to the form that shards store."""
    tensors: dict[str, np.ndarray] = {
        "vertices": sample.mesh.vertices,
        "faces": sample.mesh.faces,
        "part": sample.part,
        **{f"skeleton.{name}": value for name, value in asdict(sample.skeleton).items()},
    }
    grids = {}
    for resolution in resolutions:
        voxels, spectrum = voxel_spectrum(sample, resolution)
        tensors[f"r{resolution}.coords"] = voxels.grid.coords.astype(np.int16)
        tensors[f"r{resolution}.normals"] = voxels.normals.astype(np.float16)
        tensors[f"r{resolution}.spectrum"] = to_half(spectrum.coefficients)
        grids[resolution] = (voxels.grid.origin_m, voxels.grid.voxel_size_m)
    return StoredTree(
        seed=sample.seed, species=sample.species, split=sample.split, wind=sample.wind, tensors=tensors, grids=grids
    )


def write_shard(trees: list[StoredTree], stream: ByteWriter) -> None:
    """Write trees in the order given."""
    records = [
        {
            "seed": tree.seed,
            "species": tree.species,
            "split": tree.split,
            "wind": asdict(tree.wind),
            "grids": {str(resolution): [list(origin), size] for resolution, (origin, size) in tree.grids.items()},
        }
        for tree in trees
    ]
    head = {"version": VERSION, "fps": FPS, "num_frames": NUM_FRAMES, "trees": records}
    tensors = {
        f"{tree.seed:07d}/{name}": np.ascontiguousarray(value) for tree in trees for name, value in tree.tensors.items()
    }
    # a single entry, since safetensors writes several in random order
    stream.write(safetensors.numpy.save(tensors, metadata={METADATA: json.dumps(head, sort_keys=True)}))


def iter_shard(path: str) -> Iterator[StoredTree]:
    """Iterate over the trees of a shard; each is read lazily from the memory-mapped file.

    Raises:
        FormatError: the file is not a shard of this version.
    """
    try:
        source = safetensors.safe_open(path, framework="numpy")
    except safetensors.SafetensorError as error:
        raise FormatError(f"{path} is no safetensors file ({error}); write it again") from error
    with source as shard:
        head = json.loads((shard.metadata() or {}).get(METADATA, "{}"))
        if head.get("version") != VERSION:
            raise FormatError(
                f"{path} is a shard of version {head.get('version')}; this program reads {VERSION}; generate it again"
            )
        keys = list(shard.keys())
        for record in head["trees"]:
            prefix = f"{record['seed']:07d}/"
            own = [key.removeprefix(prefix) for key in keys if key.startswith(prefix)]
            yield StoredTree(
                seed=record["seed"],
                species=record["species"],
                split=record["split"],
                wind=Wind(**record["wind"]),
                tensors={name: shard.get_tensor(prefix + name) for name in own},
                grids={
                    int(resolution): ((origin[0], origin[1], origin[2]), size)
                    for resolution, (origin, size) in record["grids"].items()
                },
            )


def shards_sha256(paths: Sequence[str]) -> str:
    """Hash the headers of shards in order: their seeds, winds and grids determine the content."""
    digest = hashlib.sha256()
    for path in paths:
        with safetensors.safe_open(path, framework="numpy") as shard:
            digest.update((shard.metadata() or {}).get(METADATA, "").encode())
    return digest.hexdigest()
