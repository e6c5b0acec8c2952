import threading

import pytest

from dynamictree import parallel
from dynamictree.parallel import in_bands, on_cores


def test_results_come_in_order_and_the_kernels_of_a_call_stay_on_its_thread() -> None:
    def call(item: int) -> tuple[int, set[int]]:
        threads: set[int] = set()
        in_bands(lambda first, end: threads.add(threading.get_ident()), 100)
        return item, threads | {threading.get_ident()}

    results = on_cores(call, range(20))
    assert [item for item, _ in results] == list(range(20))
    assert all(len(threads) == 1 for _, threads in results)


@pytest.mark.parametrize("num_rows", [1, 2, 12, 100])
def test_bands_cover_every_row_once(num_rows: int) -> None:
    rows: list[int] = []
    in_bands(lambda first, end: rows.extend(range(first, end)), num_rows)
    assert sorted(rows) == list(range(num_rows))


def test_few_rows_start_no_thread() -> None:
    calls: list[tuple[int, int]] = []
    in_bands(lambda first, end: calls.append((first, end)), 1999, rows_per_thread=1000)
    assert calls == [(0, 1999)]


def test_there_are_no_more_threads_than_bands(monkeypatch) -> None:
    """On a machine of 64 cores, three rows start two threads beside the caller's."""
    monkeypatch.setattr(parallel, "num_cores", lambda: 64)
    together, threads = threading.Barrier(3, timeout=20), set[int]()
    before = threading.active_count()

    def kernel(first: int, end: int) -> None:
        together.wait()
        threads.add(threading.get_ident())
        assert threading.active_count() - before <= 2

    in_bands(kernel, 3)
    assert len(threads) == 3
