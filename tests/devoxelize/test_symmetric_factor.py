"""The compiled solve against a dense one."""

import numpy as np
import pytest
import scipy.sparse

from dynamictree.devoxelize.symmetric_factor import WIDTH, factored


def springs(num_vertices: int, rng: np.random.Generator) -> scipy.sparse.csr_array:
    """A symmetric, positive definite system of a net of springs [3n, 3n]."""
    edges = 4 * num_vertices
    rows, columns = np.repeat(np.arange(edges), 6), rng.integers(0, 3 * num_vertices, 6 * edges)
    strain = scipy.sparse.coo_array((rng.standard_normal(6 * edges), (rows, columns)), (edges, 3 * num_vertices))
    system = strain.T @ strain + scipy.sparse.diags_array(rng.uniform(0.5, 2, 3 * num_vertices))
    return system.tocsr()


@pytest.mark.parametrize("num_columns", [1, WIDTH, 2 * WIDTH + 3])
def test_the_solution_solves_the_system(num_columns: int) -> None:
    rng = np.random.default_rng(num_columns)
    system = springs(40, rng)
    right = rng.standard_normal((120, num_columns))
    solution = factored(system.tocsc()).solve(right)
    np.testing.assert_allclose(solution, np.linalg.solve(system.toarray(), right), rtol=1e-9, atol=1e-12)


def test_the_solution_does_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    factor, right = factored(springs(40, rng).tocsc()), rng.standard_normal((120, 96))
    solutions = []
    for cores in (1, 4):
        monkeypatch.setattr("dynamictree.devoxelize.symmetric_factor.num_cores", lambda cores=cores: cores)
        solutions.append(factor.solve(right))
    np.testing.assert_array_equal(*solutions)
