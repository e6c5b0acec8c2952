from pathlib import Path

import pytest

from dynamictree.errors import InputError
from lab.dataset.sample import make_sample
from lab.dataset.shards import store, write_shard
from lab.small.examples import iter_training


def test_training_never_meets_a_held_out_tree(tmp_path: Path) -> None:
    validation, training, held_out = (20, "shrub"), (1, "sapling"), (2, "palm")
    path = tmp_path / "shard.safetensors"
    with path.open("wb") as stream:
        write_shard([store(make_sample(*one), resolutions=(32,)) for one in (validation, training, held_out)], stream)
    assert [tree.species for tree in iter_training([str(path)], first=0, count=1)] == ["sapling"]
    with pytest.raises(InputError, match="hold 1 trees for training; 2 are needed"):
        list(iter_training([str(path)], first=0, count=2))
