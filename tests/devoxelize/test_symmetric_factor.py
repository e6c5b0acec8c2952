"""The compiled solve against a dense one."""

import numpy as np
import pytest

from dynamictree.devoxelize.symmetric_factor import WIDTH, factored
from tests.devoxelize.test_conjugate_gradients import springs


@pytest.mark.parametrize("num_columns", [1, WIDTH, 2 * WIDTH + 3])
def test_the_solution_solves_the_system(num_columns: int) -> None:
    rng = np.random.default_rng(num_columns)
    system = springs(40, rng).astype(np.float64)
    right = rng.standard_normal((120, num_columns))
    solution = factored(system.tocsc()).solve(right)
    np.testing.assert_allclose(solution, np.linalg.solve(system.toarray(), right), rtol=1e-9, atol=1e-12)


def test_the_solution_does_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    factor, right = factored(springs(40, rng).astype(np.float64).tocsc()), rng.standard_normal((120, 96))
    solutions = []
    for cores in (1, 4):
        monkeypatch.setattr("dynamictree.devoxelize.symmetric_factor.num_cores", lambda cores=cores: cores)
        solutions.append(factor.solve(right))
    np.testing.assert_array_equal(*solutions)
