"""Fixtures that every package's tests may use."""

import os
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def samples() -> Path:
    """The folder of real sample files, laid out as the README tells; skipped where DYNAMICTREE_SAMPLES is unset."""
    folder = os.environ.get("DYNAMICTREE_SAMPLES")
    if not folder:
        pytest.skip("DYNAMICTREE_SAMPLES is unset: it names the folder of real sample files")
    return Path(folder)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that is the same in every run."""
    return np.random.default_rng(20260101)
