"""Every benchmark runs: a change of a signature would break one unseen."""

import json
import os
import subprocess
import sys

import pytest

from benchmarks.__main__ import names


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", names())
def test_a_benchmark_prints_its_figures(name: str) -> None:
    """The shortest course of each ends with a JSON object; what needs a tool that is missing says so."""
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks", name],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"DYNAMICTREE_BENCHMARK_BRIEF": "1"},
    )
    if run.returncode and run.stderr.splitlines()[-1].startswith("benchmarks: "):
        pytest.skip(run.stderr.splitlines()[-1])
    assert run.returncode == 0, run.stderr[-3000:]
    figures = json.loads(run.stdout.splitlines()[-1])
    assert figures["benchmark"] == name
    assert "device" in figures
