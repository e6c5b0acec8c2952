"""Endless wind for clients: the references in Python and JavaScript give what the server's own files contain."""

# ruff: noqa: F811

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.spectrum import SparseVoxelSpectrum
from recipes.wind_reference import coordinates, wave_at
from tests.service.pushed import grown, spectrum, spectrum_id  # noqa: F401

TIMES_S = [0.0, 0.37, 59.9, 3600.25]
MODULE = Path(__file__).parents[2] / "web" / "motion" / "turbulence.js"
DRIVER = f"""
import {{ turbulentCoordinates }} from "{MODULE.as_uri()}";
const wind = JSON.parse(process.argv[2]);
const at = (t) => {{ const {{ q, turn }} = turbulentCoordinates(wind, t); return {{ q: Array.from(q), turn }}; }};
console.log(JSON.stringify({TIMES_S}.map(at)));
"""


@pytest.fixture
def wind(client: TestClient, spectrum_id: str) -> dict[str, Any]:
    answer = client.get(f"/v1/spectra/{spectrum_id}/wind", params={"seed": 7})
    assert answer.status_code == 200, answer.text
    body: dict[str, Any] = answer.json()
    return body


def test_the_python_reference_gives_the_librarys_coordinates(
    spectrum: SparseVoxelSpectrum, wind: dict[str, Any]
) -> None:
    own = turbulent_wind(spectrum, seed=7)
    times = np.array(TIMES_S)
    np.testing.assert_allclose([coordinates(wind, t) for t in TIMES_S], own.coordinates(times), atol=1e-9)
    np.testing.assert_allclose([wave_at(wind["turn_rad"], t) for t in TIMES_S], own.turn_rad.at(times), atol=1e-9)


def test_the_pages_module_gives_the_python_references_coordinates(wind: dict[str, Any], tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    driver = tmp_path / "driver.mjs"
    driver.write_text(DRIVER)
    done = subprocess.run([node, str(driver), json.dumps(wind)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for seconds, there in zip(TIMES_S, json.loads(done.stdout), strict=True):
        q = coordinates(wind, seconds)
        np.testing.assert_allclose(there["q"], np.stack([q.real, q.imag], axis=1).ravel(), atol=1e-6)
        assert there["turn"] == pytest.approx(wave_at(wind["turn_rad"], seconds), abs=1e-9)


def test_a_gust_of_the_request_replaces_the_spectrums(client: TestClient, spectrum_id: str) -> None:
    calm, wild = (client.get(f"/v1/spectra/{spectrum_id}/wind", params={"gust": gust}).json() for gust in (0, 1))
    assert not any(calm["lean"]["amplitude"])
    assert max(wild["lean"]["amplitude"]) > 0.3
    assert client.get(f"/v1/spectra/{spectrum_id}/wind", params={"gust": 3}).status_code == 422
    assert client.get("/v1/spectra/01ARZ3NDEKTSV4RRFFQ69G5FAV/wind").status_code == 404
