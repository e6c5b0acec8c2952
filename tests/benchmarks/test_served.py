"""Benchmarks of the served API run: a change of a signature would break them unseen."""

import pytest

from benchmarks import interact_latency


@pytest.mark.slow
def test_the_latency_of_pushes_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interact_latency, "RATE_S", 0.05)
    monkeypatch.setattr(interact_latency, "REQUESTS", {1: 1})
    monkeypatch.setattr(interact_latency, "FRAMES", 1)
    figures = interact_latency.run()
    assert 0 < figures["value"] < figures["p99"] + 1
    assert figures["vertices"]["frames"] == 1
