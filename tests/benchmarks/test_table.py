"""The table of all benchmarks."""

from benchmarks._table import COLUMNS, table


def test_every_benchmark_has_a_line_and_what_was_skipped_says_why() -> None:
    done = {"benchmark": "a", "value": 3, "unit": "s", "target": 4, "load": 0.5, "took_s": 7, "device": "CPU, 2 cores"}
    lines = table([done, {"benchmark": "b", "skipped": "needs h2load"}, {"benchmark": "c", "failed": "E: x | y"}])
    assert "CPU, 2 cores" in lines
    _, _, _, _, *rows = lines.splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [len(row) for row in cells] == 3 * [len(COLUMNS)]
    assert cells[0] == ["a", "3", "s", "4", "0.5", "7"]
    assert [row[:2] for row in cells[1:]] == [["b", "skipped: needs h2load"], ["c", "failed: E: x / y"]]
