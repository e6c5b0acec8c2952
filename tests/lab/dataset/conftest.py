"""Trees that several tests look at, grown once."""

import pytest

from lab.dataset.sample import Sample, make_sample


@pytest.fixture(scope="package")
def sapling() -> Sample:
    """A small tree in a strong wind."""
    return make_sample(7, "sapling")


@pytest.fixture(scope="package")
def spreading() -> Sample:
    """A tree whose trunk and branches split."""
    return make_sample(7, "spreading-broadleaf")
