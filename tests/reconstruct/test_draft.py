"""What is shown of photos while their splat is learned."""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.formats.cloud_file import read_cloud
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.reconstruct import draft as drafts
from dynamictree.reconstruct.draft import DRAFT, Draft
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import table_of_points
from tests.reconstruct.conftest import sparse_model

OPACITY = 0.1


@pytest.fixture
def published(tmp_path) -> list[GaussianCloud]:
    return []


@pytest.fixture
def draft(tmp_path, published: list[GaussianCloud]) -> Draft:
    def publish(path: Path) -> None:
        with path.open("rb") as stream:
            published.append(read_cloud(stream, file_type="splat"))

    return Draft(folder=tmp_path, on_file=publish)


def column(rng: np.random.Generator, count: int = 500) -> np.ndarray:
    """Points of a stem that stands in the middle of the region, as high as the region is wide."""
    return np.stack([*rng.normal(scale=0.05, size=(2, count)), rng.uniform(0, 0.8, count)], axis=1)


def state_at(table: np.ndarray, step: int) -> SplatState:
    state = SplatState.beginning(table)
    state.step = step
    return state


def table_of(points: np.ndarray) -> np.ndarray:
    sizes = np.full(len(points), 0.01, np.float32)
    grey = np.full((len(points), 3), 0.5, np.float32)
    return table_of_points(points.astype(np.float32), grey, sizes, opacity=OPACITY, sh_degree=1)


def test_the_points_that_photos_share_are_shown_upright_and_without_the_background(draft, published, rng):
    stem = column(rng)
    points = np.concatenate([stem, rng.normal(loc=(8, 0, 0), size=(500, 3))])
    draft.show_points(sparse_model(points=points))
    assert np.allclose(np.sort(published[0].means[:, 2]), np.sort(stem[:, 2]), atol=1e-5)
    draft.show_points(sparse_model(points=np.zeros((2, 3))))  # two are no draft
    assert len(published) == 1


def test_what_is_faint_before_learning_is_shown_and_what_was_learned_stays_as_it_is(draft, published, rng, monkeypatch):
    monkeypatch.setattr(drafts, "EVERY_S", 0.0)
    table = table_of(column(rng))
    before = table.copy()
    draft.show(state_at(table, 0))
    draft.show(state_at(table, 1))
    assert np.array_equal(table, before)
    assert published[0].opacity.min() > 0.8
    assert published[1].opacity.max() == pytest.approx(OPACITY, abs=1 / 255)


def test_a_draft_is_not_replaced_before_one_has_had_time_to_look(draft, published, rng):
    for step in range(5):
        draft.show(state_at(table_of(column(rng)), step))
    assert len(published) == 1


def test_nothing_is_left_of_a_draft_that_was_deleted(draft, published, rng, tmp_path):
    draft.show(state_at(table_of(column(rng)), 0))
    assert (tmp_path / DRAFT).exists()
    draft.delete()
    assert list(tmp_path.iterdir()) == []
