"""What a cloud must be, and its levels of detail."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import area_m2, level_of_detail, validate_cloud
from tests.formats.test_cloud_round_trips import make_cloud


def test_negative_scales_and_broken_degrees_are_refused(rng) -> None:
    cloud = make_cloud(rng)
    with pytest.raises(InputError, match="negative"):
        validate_cloud(replace(cloud, scales=-cloud.scales))
    with pytest.raises(InputError, match="5 harmonics"):
        validate_cloud(replace(cloud, sh=np.zeros((cloud.num_gaussians, 5, 3), np.float32)))


def test_a_level_of_detail_covers_the_same_area(rng) -> None:
    cloud = make_cloud(rng, 1000)
    light, _ = level_of_detail(cloud, 0.25)
    assert light.num_gaussians == 250
    before, after = ((area_m2(own) * own.opacity).sum() for own in (cloud, light))
    np.testing.assert_allclose(after, before, rtol=1e-4)
    assert level_of_detail(cloud, 1.0)[0] is cloud
    for share in (0.0, 1.5, float("nan")):
        with pytest.raises(InputError, match="level of detail"):
            level_of_detail(cloud, share)


def test_a_level_of_detail_covers_fine_parts_as_well_as_coarse_ones(rng) -> None:
    cloud = make_cloud(rng, 4000)
    fine = np.arange(4000) < 3000  # a stem, scanned from near
    size = np.where(fine, 0.01, 0.03).astype(np.float32)
    cloud = replace(cloud, scales=np.repeat(size[:, None], 3, axis=1), opacity=np.full(4000, 0.9, np.float32))
    cloud = replace(cloud, means=cloud.means + np.where(fine, 100, 0).astype(np.float32)[:, None])
    light, _ = level_of_detail(cloud, 0.1)
    assert light.num_gaussians == 400
    for part, whole in ((light.means[:, 0] > 50, fine), (light.means[:, 0] < 50, ~fine)):
        np.testing.assert_allclose(area_m2(light)[part].sum(), area_m2(cloud)[whole].sum(), rtol=0.02)
