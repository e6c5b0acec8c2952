"""From voxels and wind to a spectrum: loading a trained network, and asking it."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from jaxtyping import Float32
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from dynamictree.diffusion.channels import CHANNELS
from dynamictree.diffusion.sampler import karras_schedule, sample_heun
from dynamictree.errors import CheckpointError, InputError
from dynamictree.models.small.network import SmallNetwork, SmallPreset
from dynamictree.models.small.prepared import PreparedTree, prepare_tree
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

FORMAT, VERSION = "dynamictree-small", "5"
NUM_STEPS = 4
MAX_VOXELS = 150_000
"""At the network's own resolution; the dataset's trees have 8,000 to 35,000. Memory and time grow linearly."""
SPEEDS_M_S = (0.0, 30.0)
GUSTS = (0.0, 2.0)
WEIGHTS = Path(__file__).parents[2] / "weights"

OnStep = Callable[[int, int], None]


class TreeMotionModel:
    """A trained network, ready to be asked."""

    def __init__(self, network: SmallNetwork, *, name: str) -> None:
        self.network, self.name = network.eval().requires_grad_(False), name

    def generate(
        self,
        voxels: SurfaceVoxels,
        *,
        wind: Wind,
        seed: int,
        num_steps: int | None = None,
        on_step: OnStep | None = None,
    ) -> SparseVoxelSpectrum:
        """A motion for a voxelised tree; the same for the same seed.

        Args:
            voxels: 128³, or a power of two finer, which is generated at 128³ and raised.
            wind: speed within SPEEDS_M_S.
            seed: of the noise that the sampler starts from.
            num_steps: of the sampler, 1 to 1000; by default NUM_STEPS.
            on_step: called after each step with the steps done and their number; what it raises passes through.

        Raises:
            InputError: a resolution, voxel count, wind or number of steps outside of what the network serves.
        """
        self._check(voxels.grid, wind, num_steps)
        generator = torch.Generator().manual_seed(seed)
        with torch.no_grad(), one_thread():
            prepared = self.prepare(voxels, wind)
            start = prepared.noise.draw(self.network.noise_shares, generator, channels=CHANNELS)
            whitened = self._denoise(prepared, start, num_steps or NUM_STEPS, on_step)
            relative = prepared.assemble(whitened, generator)
        coefficients = prepared.to_metres(relative)
        return SparseVoxelSpectrum(grid=voxels.grid, coefficients=coefficients, model=self.name, seed=seed, wind=wind)

    def prepare(self, voxels: SurfaceVoxels, wind: Wind) -> PreparedTree:
        """All that comes before chance: amplitudes, lean, and the matrices between nodes and voxels."""
        return prepare_tree(self.network, voxels, wind)

    def _denoise(
        self, prepared: PreparedTree, noise: Float32[Tensor, "W J 6"], num_steps: int, on_step: OnStep | None
    ) -> Float32[Tensor, "W J 6"]:
        """A whitened spectrum on the nodes, all frequencies in one batch."""
        network, preset = self.network, self.network.preset
        sigmas = karras_schedule(num_steps, sigma_min=preset.sigma_min, sigma_max=preset.sigma_max)
        frequency = torch.arange(1, preset.num_frequencies)[None]
        condition = network.denoiser.condition(prepared.nodes, prepared.wind)

        sample = prepared.nodes.grids.levels[0].sample_of_row

        def denoise(noisy: Tensor, sigma: float) -> Tensor:
            level = torch.full(frequency.shape, sigma)
            denoised: Tensor = network.denoiser(
                noisy, level, frequency, prepared.node_log_amplitude, condition, prepared.around, sample
            )
            return denoised

        return sample_heun(denoise, noise * sigmas[0], sigmas, on_step=on_step)

    def _check(self, grid: VoxelGrid, wind: Wind, num_steps: int | None) -> None:
        own = self.network.preset.resolution
        ratio = grid.resolution / own
        if ratio < 1 or not math.log2(ratio).is_integer():
            allowed = f"{self.name} accepts {own}, {2 * own} and {4 * own}"
            raise InputError(f"the voxel grid has resolution {grid.resolution}; {allowed}; voxelise again")
        if len(grid) > MAX_VOXELS * ratio**2:
            allowed = f"at most {int(MAX_VOXELS * ratio**2):,} are allowed at {grid.resolution}"
            raise InputError(
                f"the tree has {len(grid):,} voxels; {allowed}; remove ground and background from the mesh"
            )
        for name, value, (low, high) in (("speed", wind.speed_m_s, SPEEDS_M_S), ("gust", wind.gust, GUSTS)):
            if not low <= value <= high:
                raise InputError(f"the wind's {name} is {value}; {low:g} to {high:g} is allowed")
        if not math.isfinite(wind.direction_deg):
            raise InputError(f"the wind's direction is {wind.direction_deg} degrees; it must be finite")
        if num_steps is not None and not 1 <= num_steps <= 1000:
            raise InputError(f"num_steps is {num_steps}; 1 to 1000 are allowed")


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch use one thread: the products are small, and on a machine with other work two are 10 times slower."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def load_model(name_or_path: str = "small") -> TreeMotionModel:
    """A model by the name that it ships under, or from a file.

    Raises:
        InputError: there is no such model.
        CheckpointError: the file is none of this version's.
    """
    path = Path(name_or_path)
    if path.suffix != ".safetensors":
        path = WEIGHTS / f"{name_or_path}.safetensors"
    if not path.is_file():
        shipped = ", ".join(sorted(known.stem for known in WEIGHTS.glob("*.safetensors"))) or "none"
        raise InputError(f"there is no model {name_or_path!r}; shipped: {shipped}; or give a .safetensors file")
    return TreeMotionModel(read_network(path), name=path.stem)


def write_network(network: SmallNetwork, path: Path, *, card: dict[str, str] | None = None) -> None:
    """Store weights (float16) and preset."""
    tensors = {name: value.half().contiguous() for name, value in network.state_dict().items()}
    preset = json.dumps(network.preset.to_json())
    save_file(tensors, path, {"format": FORMAT, "version": VERSION, "preset": preset, **(card or {})})


def read_network(path: Path) -> SmallNetwork:
    """Undo `write_network`.

    Raises:
        CheckpointError: not such a file, another version, or tensors that do not fit its preset.
    """
    try:
        with safe_open(path, "pt") as stored:
            metadata = stored.metadata() or {}
            tensors = {name: stored.get_tensor(name).float() for name in stored.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(f"{path.name} is no safetensors file ({error}); give a trained model") from error
    found = (metadata.get("format"), metadata.get("version"))
    if found != (FORMAT, VERSION):
        raise CheckpointError(f"{path.name} is {found[0]} version {found[1]}; {FORMAT} version {VERSION} is needed")
    network = SmallNetwork(SmallPreset.from_json(json.loads(metadata["preset"])))
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise CheckpointError(
            f"{path.name} does not fit its own preset: {str(error).splitlines()[1].strip()}"
        ) from error
    return network
