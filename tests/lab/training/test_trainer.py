"""A training that is stopped and gone on with is the training that was never stopped."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import distributed, nn

from dynamictree.errors import CheckpointError
from lab.training.checkpoints import load_part
from lab.training.trainer import LearningRateSchedule, Trainer, TrainerOptions

OPTIONS = TrainerOptions(schedule=LearningRateSchedule(num_steps=12, learning_rate=0.05, warmup_steps=3), save_every=5)


def line() -> nn.Module:
    torch.manual_seed(0)
    return nn.Linear(3, 1)


def losses(trainer: Trainer, checkpoint: Path | None = None, *, stop_after: int | None = None) -> list[float]:
    target = torch.tensor([[1.0, -2.0, 0.5]])

    def loss_of(rng: np.random.Generator) -> torch.Tensor:
        inputs = torch.from_numpy(rng.standard_normal((16, 3)).astype(np.float32))
        return (trainer.network(inputs) - inputs @ target.T).square().mean()

    return [loss for _, loss in islice(trainer.run(loss_of, checkpoint), stop_after)]


def test_a_trainer_gone_on_with_has_the_same_losses(tmp_path) -> None:
    never_stopped = Trainer(line(), OPTIONS)
    whole = losses(never_stopped)
    losses(Trainer(line(), OPTIONS), tmp_path / "line.safetensors", stop_after=5)
    gone_on = Trainer(line(), OPTIONS)
    gone_on.resume(tmp_path / "line.safetensors")
    assert gone_on.step == 5
    assert losses(gone_on) == pytest.approx(whole[5:], rel=1e-6)
    for one, other in zip(gone_on.average.parameters(), never_stopped.average.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def test_resuming_brings_the_moments_to_the_parameters_type(tmp_path) -> None:
    losses(Trainer(line(), OPTIONS), tmp_path / "line.safetensors", stop_after=5)
    resumed = Trainer(line().double(), OPTIONS)
    resumed.resume(tmp_path / "line.safetensors")
    moments = [state["exp_avg"].dtype for state in resumed.optimizer.state.values()]
    assert moments == [torch.float64, torch.float64]  # as a checkpoint read on the CPU goes to the GPU


@pytest.mark.gpu
def test_a_run_resumes_on_the_gpu(tmp_path) -> None:
    losses(Trainer(line(), OPTIONS), tmp_path / "line.safetensors", stop_after=5)
    resumed = Trainer(line().cuda(), OPTIONS)
    resumed.resume(tmp_path / "line.safetensors")
    inputs = torch.ones(1, 3, device="cuda")
    assert [step for step, _ in resumed.run(lambda rng: resumed.network(inputs).square().mean())][-1] == 12


def test_losses_fall_and_the_rate_rises_then_falls() -> None:
    schedule = LearningRateSchedule(num_steps=150, learning_rate=0.05, warmup_steps=10)
    fallen = losses(Trainer(line(), TrainerOptions(schedule=schedule)))
    assert fallen[-1] < 0.01 * fallen[0]
    rates = [schedule.rate_at(step) for step in range(150)]
    assert rates[0] < rates[9] > rates[80] > rates[149] > 0


def test_a_late_fall_does_not_change_what_came_before_it() -> None:
    schedule = LearningRateSchedule(num_steps=150, learning_rate=0.05, warmup_steps=10, cooldown_steps=50)
    rates = [schedule.rate_at(step) for step in range(150)]
    longer = replace(schedule, num_steps=400)
    assert rates[9:101] == [0.05] * 92
    assert rates[:101] == [longer.rate_at(step) for step in range(101)]
    assert rates[101:] == sorted(rates[101:], reverse=True)
    assert 0 < rates[-1] < 0.05 * 2 / 50 + 0.05 * schedule.final_share


def test_a_checkpoint_of_another_network_is_refused(tmp_path) -> None:
    trainer = Trainer(line(), OPTIONS.with_steps(1))
    losses(trainer, tmp_path / "line.safetensors")
    with pytest.raises(CheckpointError, match="differ in 1 tensors"):
        Trainer(nn.Linear(3, 1, bias=False), OPTIONS).resume(tmp_path / "line.safetensors")
    with pytest.raises(CheckpointError, match=r"weight is \(1, 3\); the network has \(2, 3\)"):
        load_part(nn.Linear(3, 2, bias=False), {"a.weight": torch.zeros(1, 3)}, "a")


def in_one_of_two_processes(rank: int, meeting: str) -> None:
    distributed.init_process_group("gloo", init_method=meeting, rank=rank, world_size=2)
    schedule = LearningRateSchedule(num_steps=3, warmup_steps=1, learning_rate=0.1)
    trainer, seen = Trainer(line(), TrainerOptions(schedule=schedule)), []

    def loss_of(rng: np.random.Generator) -> torch.Tensor:
        inputs = torch.from_numpy(rng.standard_normal((4, 3)).astype(np.float32))
        seen.append(float(inputs.sum()))
        return trainer.network(inputs).square().mean()

    list(trainer.run(loss_of))
    both = [None, None]
    distributed.all_gather_object(both, (seen[0], trainer.network.weight.tolist()))
    assert both[0][0] != both[1][0], "both processes drew the same batch"
    assert both[0][1] == both[1][1], "the processes' weights went apart"
    distributed.destroy_process_group()


@pytest.mark.slow
def test_processes_draw_their_own_batches_and_keep_the_same_weights(tmp_path) -> None:
    torch.multiprocessing.spawn(in_one_of_two_processes, (f"file://{tmp_path}/meeting",), nprocs=2)
