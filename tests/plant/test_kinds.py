"""Kinds of input that were taken wrongly once: willows cut into trees, pots that swayed, splats under a sky."""

import pytest

from tests.plant.kinds import KINDS, verdict


@pytest.mark.parametrize("name", KINDS)
def test_its_verdict_is_right(name: str, tmp_path) -> None:
    kind = KINDS[name]
    path = tmp_path / f"source.{kind.file_type}"
    path.write_bytes(kind.content())
    stated = verdict(path)
    assert kind.is_right(stated), stated
