"""The model as callers see it: deterministic, cancellable, and clear about what it does not serve."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from dynamictree.errors import Cancelled, CheckpointError, InputError
from dynamictree.models import MotionModel, load_model
from dynamictree.models.motion_model import Sampling
from dynamictree.models.small.amplitude import DRAG_EXPONENT, FLOOR, NUM_INPUTS, above_floor
from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.generate import MAX_VOXELS, SmallModel, noise_at
from dynamictree.models.small.network import SmallNetwork, SmallPreset
from dynamictree.models.small.spread import with_spread
from dynamictree.models.voxel_resolution import coarsened, halvings_served
from dynamictree.models.weights_file import write_weights
from dynamictree.models.wind import REFERENCE_SPEED
from dynamictree.spectrum import NUM_FREQUENCIES, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

WIND = Wind(speed_m_s=6.0, direction_deg=30.0, gust=0.3)


def tiny_network() -> SmallNetwork:
    torch.manual_seed(0)
    preset = SmallPreset(
        foliage_widths=(8, 8, 8),
        amplitude_width=16,
        amplitude_depth=1,
        denoiser=DenoiserShape(width=8, embedding=8, num_blocks=1),
    )
    network = SmallNetwork(preset)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    return network.eval()


@pytest.fixture(scope="module")
def model() -> SmallModel:
    return SmallModel(tiny_network(), name="tiny")


@pytest.fixture(scope="module")
def shipped() -> MotionModel:
    return load_model("small")


def test_the_same_seed_gives_the_same_motion_and_another_seed_another(model: SmallModel, voxels: SurfaceVoxels) -> None:
    first, again, other = (model.generate(voxels, wind=WIND, seed=seed, num_steps=2) for seed in (3, 3, 4))
    assert (first.coefficients == again.coefficients).all()
    assert np.abs(first.coefficients - other.coefficients).max() > 0
    assert (first.model, first.seed, first.wind) == ("tiny", 3, WIND)
    assert (first.coefficients[:, 0].imag == 0).all()
    # the lean is decided by shape and wind, not by chance
    np.testing.assert_array_equal(first.coefficients[:, 0], other.coefficients[:, 0])


def test_the_gusts_of_a_seed_change_with_the_speed_and_little_with_little() -> None:
    def gusts(speed_m_s: float, seed: int = 3) -> torch.Tensor:
        return noise_at(speed_m_s, seed, lambda generator: torch.randn(20_000, generator=generator))

    def alike(one: torch.Tensor, other: torch.Tensor) -> float:
        return float(torch.corrcoef(torch.stack([one, other]))[0, 1])

    assert torch.equal(gusts(5.0), gusts(5.0))
    assert alike(gusts(5.0), gusts(5.0, seed=4)) == pytest.approx(0, abs=0.03)
    assert alike(gusts(3.0), gusts(8.0)) == pytest.approx(0, abs=0.03)
    assert alike(gusts(0.0), gusts(0.05)) == pytest.approx(1)  # a calm
    for speed_m_s in (0.3, 3.99, 4.0, 25.0):
        assert alike(gusts(speed_m_s), gusts(1.05 * speed_m_s)) > 0.99
        assert gusts(speed_m_s).square().mean() == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("lowest_bin", [4, 7, NUM_FREQUENCIES])
def test_what_is_generated_does_not_depend_on_bins_that_are_left_out(
    model: SmallModel, voxels: SurfaceVoxels, lowest_bin: int
) -> None:
    whole, part = (model.generate(voxels, wind=WIND, seed=3, num_steps=2, lowest_bin=k) for k in (1, lowest_bin))
    np.testing.assert_array_equal(part.coefficients[:, lowest_bin:], whole.coefficients[:, lowest_bin:])
    assert (part.coefficients[:, 1] != whole.coefficients[:, 1]).any()


def test_the_motion_does_not_depend_on_the_number_of_cores(
    model: SmallModel, voxels: SurfaceVoxels, monkeypatch
) -> None:
    motions = []
    for cores in (1, 4):
        monkeypatch.setattr("dynamictree.models.threads.num_cores", lambda cores=cores: cores)
        motions.append(model.generate(voxels, wind=WIND, seed=3, num_steps=2).coefficients)
    np.testing.assert_array_equal(*motions)


def test_what_is_at_the_floor_of_the_training_stands_exactly_still() -> None:
    gust = torch.tensor([[math.log(REFERENCE_SPEED), 0.3]])  # where the drag is 1
    still = above_floor(torch.full((2, 15, 3), math.log(0.299 * FLOOR)), gust)
    assert (still == 0).all()
    assert above_floor(torch.full((1, 15, 3), -5.0), gust) == pytest.approx(math.exp(-5.0), rel=1e-4)


def test_what_hardly_moves_hardly_leans() -> None:
    network = tiny_network().amplitude
    torch.nn.init.zeros_(network.sizes.weight)
    torch.nn.init.ones_(network.sizes.bias)
    torch.nn.init.zeros_(network.second_order.bias)
    torch.nn.init.zeros_(network.second_order.weight)
    inputs, wind = torch.zeros(1, NUM_INPUTS), torch.tensor([[math.log(6.0), 0.3]])
    lean, log_amplitude = network(inputs, wind)
    with torch.no_grad():
        network.sizes.bias[3:] -= math.log(100.0)  # all but the lean's
    smaller, hundredth = network(inputs, wind)
    torch.testing.assert_close(hundredth, log_amplitude - math.log(100.0))
    torch.testing.assert_close(100 * smaller, lean)


def test_whatever_was_learnt_motion_grows_with_the_drag_at_most_and_ever_less() -> None:
    network = tiny_network().amplitude
    torch.nn.init.normal_(network.saturation.weight)
    inputs = torch.randn(200, NUM_INPUTS)
    speeds = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0]
    winds = [torch.tensor([[math.log(speed), 0.3]]).expand(200, 2) for speed in speeds]
    with torch.no_grad():
        sizes = torch.stack([network(inputs, wind)[1][:, :, :2] for wind in winds])  # level motion
    exponents = sizes.diff(dim=0) / math.log(2)
    assert (exponents >= -1e-4).all()
    assert (exponents <= DRAG_EXPONENT + 1e-4).all()
    assert (exponents.diff(dim=0) <= 1e-4).all()
    assert exponents[0].median() > 1.3
    assert exponents[-1].median() < exponents[0].median()


def test_the_sampler_keeps_to_its_device(model: SmallModel, voxels: SurfaceVoxels, monkeypatch) -> None:
    """Tensors without values stand in for a GPU's: as those, they refuse to mix with others."""
    monkeypatch.setattr(torch.Tensor, "cpu", lambda tensor: torch.zeros(tensor.shape))
    small, prepared = SmallModel(tiny_network(), name="tiny", device=torch.device("meta")), model.prepare(voxels, WIND)
    forces = prepared.noise.draw(small.network.common_share, torch.Generator())
    noise = prepared.noise.pool.apply(prepared.noise.field(forces))
    sampling = Sampling(seed=0, num_steps=2, lowest_bin=4, on_step=None)
    assert small._denoise(prepared, noise, sampling).shape == noise.shape


@pytest.mark.gpu
def test_a_gpu_gives_the_motion_of_the_processor(voxels: SurfaceVoxels) -> None:
    if not torch.cuda.is_available():
        pytest.skip("a CUDA device is not there")
    devices = [torch.device(name) for name in ("cpu", "cuda")]
    models = [SmallModel(tiny_network(), name="tiny", device=device) for device in devices]
    cpu, gpu = (model.generate(voxels, wind=WIND, seed=3).coefficients for model in models)
    np.testing.assert_allclose(gpu, cpu, atol=1e-3 * voxels.grid.height_m)


def test_every_sampler_step_is_reported_and_may_cancel(model: SmallModel, voxels: SurfaceVoxels) -> None:
    steps: list[tuple[int, int]] = []
    model.generate(voxels, wind=WIND, seed=0, num_steps=3, on_step=lambda *step: steps.append(step))
    assert steps == [(1, 3), (2, 3), (3, 3)]

    def cancel(done: int, total: int) -> None:
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        model.generate(voxels, wind=WIND, seed=0, on_step=cancel)


def test_a_finer_grid_is_generated_at_the_networks_own_and_raised(model: SmallModel, voxels: SurfaceVoxels) -> None:
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.int32)
    coords = (2 * voxels.grid.coords[:, None] + corners).reshape(-1, 3)
    grid = VoxelGrid.from_coords(coords, origin_m=voxels.grid.origin_m, voxel_size_m=0.05, resolution=256)
    fine = SurfaceVoxels(grid=grid, normals=np.tile(np.float32([0, 0, 1]), (len(grid), 1)))
    coarse, raised = coarsened(fine, 1)
    assert (coarse.grid.coords == voxels.grid.coords).all()
    np.testing.assert_allclose(raised @ np.ones(len(coarse.grid)), 1, rtol=1e-5)
    spectrum = model.generate(fine, wind=WIND, seed=0, num_steps=1)
    assert spectrum.coefficients.shape == (len(grid), 16, 3)
    assert coarsened(voxels, 0) == (voxels, None)


def test_a_grid_is_halved_until_the_network_can_read_it() -> None:
    grid = _block(16).grid
    for most, halvings in ((16**3, 0), (8**3, 1), (8**3 - 1, 2), (1, 4)):
        assert halvings_served(grid, 128, "small", max_voxels=most) == halvings


def _block(side: int, resolution: int = 128) -> SurfaceVoxels:
    coords = np.argwhere(np.ones((side, side, side), bool)).astype(np.int32)
    grid = VoxelGrid(coords=coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=0.1, resolution=resolution)
    return SurfaceVoxels(grid=grid, normals=np.broadcast_to(np.float32([0, 0, 1]), coords.shape))


def test_what_the_model_does_not_serve_is_refused(model: SmallModel, voxels: SurfaceVoxels) -> None:
    coarse = VoxelGrid.from_coords(
        voxels.grid.coords // 2, origin_m=voxels.grid.origin_m, voxel_size_m=0.2, resolution=64
    )
    blank = SurfaceVoxels(grid=coarse, normals=np.zeros((len(coarse), 3), np.float32))
    with pytest.raises(InputError, match="accepts 128, 256 and 512"):
        model.generate(blank, wind=WIND, seed=0)
    block = _block(134, resolution=256)
    assert len(block.grid) > MAX_VOXELS
    with pytest.raises(InputError, match="2,406,104 voxels; at most 2,400,000 are allowed; take a lower resolution"):
        model.generate(block, wind=WIND, seed=0)
    for wind, reason in (
        (replace(WIND, speed_m_s=31.0), "speed is 31"),
        (replace(WIND, gust=-0.1), "gust is -0.1"),
        (replace(WIND, direction_deg=float("nan")), "direction is nan"),
    ):
        with pytest.raises(InputError, match=reason):
            model.generate(voxels, wind=wind, seed=0)
    with pytest.raises(InputError, match="num_steps is 0"):
        model.generate(voxels, wind=WIND, seed=0, num_steps=0)


def test_files_that_are_no_models_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="no model 'large'; available: "):
        load_model("large")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"no header")
    with pytest.raises(CheckpointError, match="no safetensors file"):
        load_model(str(broken))
    save_file({"a": torch.zeros(1)}, broken, {"format": SmallNetwork.KIND, "version": "0"})
    with pytest.raises(CheckpointError, match="version 0"):
        load_model(str(broken))
    kind = {"format": SmallNetwork.KIND, "version": SmallNetwork.VERSION}
    save_file({"a": torch.zeros(1)}, broken, {**kind, "preset": '{"denoiser": {"width": "wide"}}'})
    with pytest.raises(CheckpointError, match=r"a preset that cannot be read: denoiser\.width: .*integer"):
        load_model(str(broken))
    network = tiny_network()
    del network.denoiser.head.bias
    write_weights(network, broken)
    with pytest.raises(CheckpointError, match="does not fit its own preset"):
        load_model(str(broken))


@pytest.mark.parametrize("spread", [0.0, 0.5, 1.0, 1.5, 2.0])
def test_sizes_get_their_spread_and_phases_stay(spread: float) -> None:
    field = torch.randn(100_000, 2, 3, dtype=torch.complex64, generator=torch.Generator().manual_seed(0))
    drawn = with_spread(field, torch.full((2, 3), spread))
    torch.testing.assert_close(drawn.angle(), field.angle(), atol=1e-3, rtol=0)
    assert drawn.abs().square().mean().item() == pytest.approx(1, abs=1e-3)
    sizes = drawn.abs().log().flatten(1)
    assert 2 * sizes.std(dim=0).numpy() == pytest.approx(spread * math.pi / math.sqrt(6), abs=0.2)
    if spread:
        likeness = (torch.corrcoef(sizes.T).sum() - 6).item() / 30  # correlation of two frequencies or axes
        assert likeness > 0.6 if spread > 1 else abs(likeness) < 0.01


def test_in_the_shipped_model_more_wind_moves_more_and_the_lean_points_downwind(
    shipped: MotionModel, voxels: SurfaceVoxels
) -> None:
    sizes, leans = [], []
    for speed in (2.0, 5.0, 10.0):
        wind = replace(WIND, speed_m_s=speed)
        coefficients = shipped.generate(voxels, wind=wind, seed=0, num_steps=2).coefficients
        sizes.append(np.linalg.norm(coefficients[:, 1:]))
        leans.append(coefficients[:, 0].real.mean(axis=0))
    assert sizes[0] < sizes[1] < sizes[2]
    angle = np.deg2rad(WIND.direction_deg)
    for lean in leans:
        assert lean[:2] @ np.array([np.cos(angle), np.sin(angle)]) > 0.8 * np.linalg.norm(lean)


def test_in_the_shipped_model_roots_stay(shipped: MotionModel, voxels: SurfaceVoxels) -> None:
    coefficients = shipped.generate(voxels, wind=WIND, seed=0, num_steps=2).coefficients
    height_m = np.ptp(voxels.grid.coords[:, 2]) * voxels.grid.voxel_size_m
    low = voxels.grid.coords[:, 2] <= voxels.grid.coords[:, 2].min() + 1
    bound = np.linalg.norm(np.abs(coefficients[low]), axis=2).sum(axis=1)
    assert bound.max() < 0.005 * height_m


def test_generating_leaves_the_number_of_threads_as_it_was(model: SmallModel, voxels: SurfaceVoxels) -> None:
    during: list[int] = []
    torch.set_num_threads(2)
    model.generate(voxels, wind=WIND, seed=0, num_steps=1, on_step=lambda *_: during.append(torch.get_num_threads()))
    assert (during, torch.get_num_threads()) == ([1], 2)
    torch.set_num_threads(1)
