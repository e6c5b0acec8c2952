"""What a cloud must be, and its levels of detail."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import MAX_GAUSSIANS, area_m2, check_count, look_level, validate_cloud
from tests.formats.test_cloud_round_trips import make_cloud


@pytest.mark.parametrize("name", ["means", "quaternions", "scales", "opacity", "sh"])
def test_values_that_are_not_finite_are_refused_by_name_and_place(rng, name: str) -> None:
    cloud = make_cloud(rng)
    values = getattr(cloud, name).copy()
    values[7] = np.nan
    with pytest.raises(InputError, match=f"{name} of 1 Gaussians are not finite, the first is Gaussian 7"):
        validate_cloud(replace(cloud, **{name: values}))


def test_a_cloud_of_which_nothing_is_seen_is_refused(rng) -> None:
    cloud = make_cloud(rng)
    with pytest.raises(InputError, match="nothing is visible"):
        validate_cloud(replace(cloud, opacity=np.zeros_like(cloud.opacity)))


def test_an_empty_and_a_too_large_cloud_are_refused() -> None:
    with pytest.raises(InputError, match="empty"):
        check_count(0)
    with pytest.raises(InputError, match="50,000,000"):
        check_count(50_000_000)
    check_count(MAX_GAUSSIANS)


def test_negative_scales_and_broken_degrees_are_refused(rng) -> None:
    cloud = make_cloud(rng)
    with pytest.raises(InputError, match="negative"):
        validate_cloud(replace(cloud, scales=-cloud.scales))
    with pytest.raises(InputError, match="5 harmonics"):
        validate_cloud(replace(cloud, sh=np.zeros((cloud.num_gaussians, 5, 3), np.float32)))


def test_a_level_of_detail_covers_the_same_area(rng) -> None:
    cloud = make_cloud(rng, 1000)
    light = look_level(cloud, 0.25)
    assert light.num_gaussians == 250
    before, after = ((area_m2(own) * own.opacity).sum() for own in (cloud, light))
    np.testing.assert_allclose(after, before, rtol=1e-4)
    assert look_level(cloud, 1.0) is cloud
    for share in (0.0, 1.5, float("nan")):
        with pytest.raises(InputError, match="level of detail"):
            look_level(cloud, share)


def test_a_level_of_detail_covers_fine_parts_as_well_as_coarse_ones(rng) -> None:
    cloud = make_cloud(rng, 4000)
    fine = np.arange(4000) < 3000  # a stem, scanned from near
    size = np.where(fine, 0.01, 0.03).astype(np.float32)
    cloud = replace(cloud, scales=np.repeat(size[:, None], 3, axis=1), opacity=np.full(4000, 0.9, np.float32))
    cloud = replace(cloud, means=cloud.means + np.where(fine, 100, 0).astype(np.float32)[:, None])
    light = look_level(cloud, 0.1)
    assert light.num_gaussians == 400
    for part, whole in ((light.means[:, 0] > 50, fine), (light.means[:, 0] < 50, ~fine)):
        np.testing.assert_allclose(area_m2(light)[part].sum(), area_m2(cloud)[whole].sum(), rtol=0.02)


def test_a_lower_degree_keeps_the_lower_harmonics(rng) -> None:
    cloud = make_cloud(rng, degree=3)
    assert cloud.sh_degree == 3
    np.testing.assert_array_equal(cloud.with_sh_degree(1).sh, cloud.sh[:, :4])
    assert cloud.with_sh_degree(1).with_sh_degree(3).sh_degree == 1
