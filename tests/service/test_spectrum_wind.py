"""Endless wind for clients: the references in Python and JavaScript give what the server's own files contain."""

# ruff: noqa: F811

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.wind_bands import bands_of_sizes
from recipes.wind_reference import coordinates, wave_at
from tests.js_tools import in_node
from tests.service.pushed import client, grown, spectrum_id  # noqa: F401
from tests.service.pushed import spectrum as of_one_wind  # noqa: F401

GAINS = [4.0, *(6.0 - k / 8 for k in range(1, 16))]  # values that float32 holds
TIMES_S = [0.0, 0.37, 59.9, 3600.25]
SPEED_M_S = 16.0
MODULE = Path(__file__).parents[2] / "web" / "motion" / "turbulence.js"
DRIVER = f"""
import {{ turbulentMotion }} from "{MODULE.as_uri()}";
const wind = JSON.parse(process.argv[1]);
const at = (t) => turbulentMotion(wind, t, {{ speed: {SPEED_M_S} }});
console.log(JSON.stringify({TIMES_S}.map(at).map(({{ q, turn }}) => ({{ q: Array.from(q), turn }}))));
"""


@pytest.fixture(scope="module")
def spectrum(of_one_wind: SparseVoxelSpectrum) -> SparseVoxelSpectrum:
    assert of_one_wind.wind is not None
    own = of_one_wind.wind.speed_m_s
    return replace(of_one_wind, bands=bands_of_sizes({own: np.ones(16), 20.0: np.array(GAINS)}, own))


@pytest.fixture(scope="module")
def wind(client: TestClient, spectrum_id: str) -> dict[str, Any]:
    answer = client.get(f"/v1/spectra/{spectrum_id}/wind", params={"seed": 7})
    assert answer.status_code == 200, answer.text
    body: dict[str, Any] = answer.json()
    return body


def test_the_python_reference_gives_the_librarys_coordinates(spectrum, wind) -> None:
    own = turbulent_wind(spectrum, seed=7)
    times = np.array(TIMES_S)
    np.testing.assert_allclose([coordinates(wind, t) for t in TIMES_S], own.coordinates(times), atol=1e-9)
    np.testing.assert_allclose([wave_at(wind["turn_rad"], t) for t in TIMES_S], own.turn_rad.at(times), atol=1e-9)


def test_the_pages_module_gives_the_python_references_coordinates(wind: dict[str, Any]) -> None:
    for seconds, there in zip(TIMES_S, in_node(DRIVER, json.dumps(wind)), strict=True):
        q = coordinates(wind, seconds, SPEED_M_S)
        np.testing.assert_allclose(there["q"], np.stack([q.real, q.imag], axis=1).ravel(), atol=1e-6)
        assert there["turn"] == pytest.approx(wave_at(wind["turn_rad"], seconds), abs=1e-9)


def test_a_speed_of_the_request_makes_each_mode_as_strong_as_the_model_says(
    client: TestClient, spectrum_id: str, spectrum: SparseVoxelSpectrum, wind: dict[str, Any]
) -> None:
    assert client.get(f"/v1/spectra/{spectrum_id}").json()["wind_bands"]["gains"][2] == GAINS
    answer = client.get(f"/v1/spectra/{spectrum_id}/wind", params={"seed": 7, "speed_m_s": 20.0}).json()
    assert answer["bands"] == wind["bands"]
    own, storm = coordinates(wind | {"wind": answer["wind"]}, 0.0), coordinates(wind, 0.0)
    np.testing.assert_allclose(own / storm, GAINS)
    assert answer["wind"]["speed_m_s"] == 20.0


def test_a_gust_of_the_request_replaces_the_spectrums(client: TestClient, spectrum_id: str) -> None:
    calm, wild = (client.get(f"/v1/spectra/{spectrum_id}/wind", params={"gust": gust}).json() for gust in (0, 1))
    assert not any(calm["lean"]["amplitude"])
    assert max(wild["lean"]["amplitude"]) > 0.3
    assert client.get(f"/v1/spectra/{spectrum_id}/wind", params={"gust": 3}).status_code == 422
    assert client.get("/v1/spectra/01ARZ3NDEKTSV4RRFFQ69G5FAV/wind").status_code == 404
