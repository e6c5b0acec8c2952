"""The compiled solver against the method as it is written in the book."""

import numpy as np
import pytest
import scipy.sparse

from dynamictree.devoxelize.conjugate_gradients import WIDTH, conjugate_gradients


def springs(num_vertices: int, rng: np.random.Generator) -> scipy.sparse.csr_array:
    """A symmetric, positive definite system of a net of springs [3n, 3n]."""
    edges = 4 * num_vertices
    rows, columns = np.repeat(np.arange(edges), 6), rng.integers(0, 3 * num_vertices, 6 * edges)
    strain = scipy.sparse.coo_array((rng.standard_normal(6 * edges), (rows, columns)), (edges, 3 * num_vertices))
    system = strain.T @ strain + scipy.sparse.diags_array(rng.uniform(0.5, 2, 3 * num_vertices))
    return system.astype(np.float32).tocsr()


def by_the_book(system: scipy.sparse.csr_array, right: np.ndarray, start: np.ndarray, steps: int) -> np.ndarray:
    """Saad, algorithm 9.1, preconditioned by 3 x 3 blocks, one column at a time in double precision."""
    matrix, solutions = system.toarray().astype(np.float64), []
    vertices = np.kron(np.eye(len(matrix) // 3), np.ones((3, 3)))
    inverse = np.linalg.inv(matrix * vertices)  # of the blocks on the diagonal
    for column, solution in zip(right.T.astype(np.float64), start.T.astype(np.float64), strict=True):
        residual = column - matrix @ solution
        direction = inverse @ residual
        product = residual @ direction
        for _ in range(steps):
            image = matrix @ direction
            step = product / (direction @ image)
            solution, residual = solution + step * direction, residual - step * image
            former, product = product, residual @ (inverse @ residual)
            direction = inverse @ residual + product / former * direction
        solutions.append(solution)
    return np.stack(solutions, axis=1)


@pytest.mark.parametrize("num_columns", [1, WIDTH, 2 * WIDTH + 3])
def test_all_columns_take_the_books_steps(num_columns: int) -> None:
    rng = np.random.default_rng(num_columns)
    system = springs(40, rng)
    right, start = (rng.standard_normal((120, num_columns)).astype(np.float32) for _ in range(2))
    result = conjugate_gradients(system, right, start, 5)
    np.testing.assert_allclose(result, by_the_book(system, right, start, 5), rtol=2e-3, atol=2e-4)


def test_what_is_solved_already_stays() -> None:
    rng = np.random.default_rng(0)
    system = springs(20, rng)
    still = np.zeros((60, 2), np.float32)
    assert (conjugate_gradients(system, still, still, 10) == 0).all()


def test_the_solution_does_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    system, right = springs(40, rng), rng.standard_normal((120, 64)).astype(np.float32)
    solutions = []
    for cores in (1, 4):
        monkeypatch.setattr("dynamictree.devoxelize.conjugate_gradients.num_cores", lambda cores=cores: cores)
        solutions.append(conjugate_gradients(system, right, np.zeros_like(right), 8))
    np.testing.assert_array_equal(*solutions)
