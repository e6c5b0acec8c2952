"""Kinds of input that were taken wrongly once: willows cut into trees, pots that swayed, splats under a sky."""

import pytest

from tests.plant.kinds import KINDS, Kind, verdict


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_its_verdict_is_right(kind: Kind, tmp_path) -> None:
    path = tmp_path / f"source.{kind.file_type}"
    path.write_bytes(kind.content())
    stated = verdict(path)
    assert len(set(stated["warnings"])) == len(stated["warnings"])
    assert kind.is_right(stated), stated
