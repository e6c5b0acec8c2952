"""/v1/interact within its declared ranges, the ends of each together with the ends of its neighbours."""

import math
from itertools import product

import numpy as np
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynamictree.request_model import LARGEST
from service.http.request_headers import SAFETENSORS
from service.interact.forces import InteractRequest
from tests.service.pushed import client, grown, poke, post, spectrum, spectrum_id  # noqa: F401
from tests.service.test_interact import read_binary


def ends(name: str) -> tuple[float, float]:
    """The least and the largest value that the request declares."""
    bounds = {}
    for constraint in InteractRequest.model_fields[name].metadata:
        bounds |= {key: getattr(constraint, key) for key in ("ge", "gt", "le") if hasattr(constraint, key)}
    assert "gt" not in bounds, f"{name} has no least value"
    return bounds["ge"], bounds["le"]


def within(name: str) -> st.SearchStrategy[float]:
    low, high = ends(name)
    lowest = max(low, high * 1e-9)
    logarithmic = st.floats(math.log(lowest), math.log(high)).map(lambda x: min(max(math.exp(x), lowest), high))
    return st.one_of(st.sampled_from((low, high)), logarithmic)


COMPONENT = st.one_of(st.sampled_from((-LARGEST, 0.0, 1e-300, LARGEST)), st.floats(-10, 10))
VECTOR = st.tuples(COMPONENT, COMPONENT, COMPONENT)
AT = st.one_of(
    st.builds(
        lambda voxel, radius: {"voxel": voxel, "radius_m": radius}, st.integers(0, 99), st.sampled_from((0, 1e3))
    ),
    st.builds(lambda point: {"point_m": point}, VECTOR),
)
TIMES = {"start_s": st.sampled_from((-1e6, 0.0, 0.01, 1e6)), "duration_s": st.sampled_from((None, 0.0, 0.1, 1e6))}
FORCE = st.one_of(
    st.fixed_dictionaries({"kind": st.just("impulse"), "at": AT, "impulse_n_s": VECTOR, **TIMES}),
    st.fixed_dictionaries({"kind": st.just("drag"), "at": AT, "force_n": VECTOR, **TIMES}),
    st.fixed_dictionaries({"kind": st.just("drag"), "at": AT, "displacement_m": VECTOR, **TIMES}),
    st.fixed_dictionaries({"kind": st.just("wind"), "wind_m_s": VECTOR, **TIMES}),
)
RANGES = ("dt_s", "damping_ratio", "frequency_hz", "mass_kg", "falloff_m")
OPTIONS = st.fixed_dictionaries(
    {name: within(name) for name in RANGES}
    | {
        "start": st.sampled_from(("rest", "held")),
        "locality": st.sampled_from(("none", "geodesic")),
    }
)


def refused_or_finite(client: TestClient, spectrum_id: str, *forces: object, **options: object) -> None:  # noqa: F811
    response = post(client, spectrum_id, *forces, accept=SAFETENSORS, num_frames=3, **options)
    if response.status_code == 422 and response.json()["code"] == "invalid-input":
        return  # the force acts nowhere on this tree
    assert response.status_code == 200, (response.json()["code"], response.json()["detail"])
    for name, array in read_binary(response).items():
        assert np.isfinite(array).all(), name


def test_the_ends_of_all_ranges_together(client: TestClient, spectrum_id: str, poke: dict) -> None:  # noqa: F811
    names = ("dt_s", "damping_ratio", "frequency_hz", "mass_kg")
    for values in product(*(ends(name) for name in names)):
        refused_or_finite(client, spectrum_id, poke, **dict(zip(names, values, strict=True)))
    for dt_s in (10.0, 1.0):  # long steps of a stiff, overdamped tree
        refused_or_finite(client, spectrum_id, poke, damping_ratio=2.0, frequency_hz=7.0, dt_s=dt_s)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(force=FORCE, options=OPTIONS)
def test_any_force_within_any_range(client: TestClient, spectrum_id: str, force: dict, options: dict) -> None:  # noqa: F811
    refused_or_finite(client, spectrum_id, force, **options)
