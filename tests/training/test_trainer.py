"""A training that is stopped and gone on with is the training that was never stopped."""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from dynamictree.errors import CheckpointError
from dynamictree.training.trainer import Course, Pace, load_part

PACE = Pace(num_steps=12, learning_rate=0.05, warmup_steps=3, save_every=5)


def line() -> nn.Module:
    torch.manual_seed(0)
    return nn.Linear(3, 1)


def losses(course: Course, checkpoint: Path | None = None, *, stop_after: int | None = None) -> list[float]:
    target = torch.tensor([[1.0, -2.0, 0.5]])

    def loss_of(rng: np.random.Generator) -> torch.Tensor:
        inputs = torch.from_numpy(rng.standard_normal((16, 3)).astype(np.float32))
        return (course.network(inputs) - inputs @ target.T).square().mean()

    return [loss for _, loss in islice(course.run(loss_of, checkpoint), stop_after)]


def test_a_course_gone_on_with_has_the_same_losses(tmp_path: Path) -> None:
    never_stopped = Course(line(), PACE)
    whole = losses(never_stopped)
    losses(Course(line(), PACE), tmp_path / "line.safetensors", stop_after=5)
    gone_on = Course(line(), PACE)
    gone_on.resume(tmp_path / "line.safetensors")
    assert gone_on.step == 5
    assert losses(gone_on) == pytest.approx(whole[5:], rel=1e-6)
    for one, other in zip(gone_on.average.parameters(), never_stopped.average.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def test_losses_fall_and_the_rate_rises_then_falls() -> None:
    pace = Pace(num_steps=150, learning_rate=0.05, warmup_steps=10)
    fallen = losses(Course(line(), pace))
    assert fallen[-1] < 0.01 * fallen[0]
    rates = [pace.rate_at(step) for step in range(150)]
    assert rates[0] < rates[9] > rates[80] > rates[149] > 0


def test_a_late_fall_does_not_change_what_came_before_it() -> None:
    pace = Pace(num_steps=150, learning_rate=0.05, warmup_steps=10, cooldown_steps=50)
    rates = [pace.rate_at(step) for step in range(150)]
    longer = replace(pace, num_steps=400)
    assert rates[9:101] == [0.05] * 92
    assert rates[:101] == [longer.rate_at(step) for step in range(101)]
    assert rates[101:] == sorted(rates[101:], reverse=True)
    assert 0 < rates[-1] < 0.05 * 2 / 50 + 0.05 * pace.final_share


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path) -> None:
    course = Course(line(), Pace(num_steps=1, save_every=1))
    losses(course, tmp_path / "line.safetensors")
    with pytest.raises(CheckpointError, match="differ in 1 tensors"):
        Course(nn.Linear(3, 1, bias=False), PACE).resume(tmp_path / "line.safetensors")
    with pytest.raises(CheckpointError, match=r"weight is \(1, 3\); the network has \(2, 3\)"):
        load_part(nn.Linear(3, 2, bias=False), {"a.weight": torch.zeros(1, 3)}, "a")


TWO_PROCESSES = """
import sys, numpy as np, torch, torch.distributed as dist
sys.path.insert(0, {root!r})
from dynamictree.training.trainer import Course, Pace
rank, port = int(sys.argv[1]), sys.argv[2]
dist.init_process_group("gloo", init_method="tcp://127.0.0.1:" + port, rank=rank, world_size=2)
torch.manual_seed(0)
course = Course(torch.nn.Linear(3, 1), Pace(num_steps=3, warmup_steps=1, learning_rate=0.1))
seen = []
def loss_of(rng):
    inputs = torch.from_numpy(rng.standard_normal((4, 3)).astype(np.float32)); seen.append(float(inputs.sum()))
    return course.network(inputs).square().mean()
list(course.run(loss_of))
gathered = [None, None]
dist.all_gather_object(gathered, (seen[0], course.network.weight.tolist()))
assert gathered[0][0] != gathered[1][0], "both processes drew the same batch"
assert gathered[0][1] == gathered[1][1], "the processes' weights went apart"
dist.barrier()
dist.destroy_process_group()
"""


def test_processes_draw_their_own_batches_and_keep_the_same_weights(tmp_path: Path) -> None:
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    script = tmp_path / "two.py"
    script.write_text(TWO_PROCESSES.format(root=str(Path(__file__).parents[2])))
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    both = [subprocess.Popen([sys.executable, str(script), str(rank), port], env=environment) for rank in (0, 1)]
    assert [process.wait(timeout=120) for process in both] == [0, 0]
