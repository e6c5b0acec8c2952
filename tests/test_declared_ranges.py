"""A declared range is a promise: every bound of a request works together with the bounds of each other field."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from dynamictree import method
from dynamictree.errors import InputError, UnstableTimestep
from dynamictree.modal.force import Drag, Impulse, WindField, contact_at_voxel
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import chosen_falloff_m, modal_system
from dynamictree.requests import ExportParams, InteractParams, Request, SpectrumParams, Wind
from tests.modal.conftest import rod_spectrum
from tests.plant.stand import tree

STEPS_S = 1e-6, 1 / 60, 10.0
"""Bounds and default of a step in `POST /v1/interact`."""


def edges(model: type[Request]) -> dict[str, list[Any]]:
    """Both bounds of each number, and the choices of a field that has some, by the model's JSON schema."""
    bounds = {}
    for name, field in model.model_json_schema()["properties"].items():
        kinds = field.get("anyOf", [field])
        if (kind := next((kind for kind in kinds if kind.get("type") != "null"), {})).get("type") == "boolean":
            bounds[name] = [False, True]
        elif "enum" in kind:
            bounds[name] = kind["enum"]
        elif kind.get("type") in ("number", "integer"):
            low = kind["minimum"] if "minimum" in kind else np.nextafter(kind["exclusiveMinimum"], 1)
            bounds[name] = [low, kind["maximum"]]
    return bounds


def pairs(model: type[Request], **others: Any) -> Iterator[Any]:
    """Requests in which two fields are at bounds, for each pair of fields and of their bounds."""
    for (first, ours), (second, theirs) in itertools.combinations(edges(model).items(), 2):
        for one, other in itertools.product(ours, theirs):
            yield model.model_validate(others | {first: one, second: other})


def test_a_push_is_answered_at_all_bounds() -> None:
    """Coordinates are finite; an integrator that would diverge says so, and the exact one never does."""
    spectrum = rod_spectrum()
    at = contact_at_voxel(spectrum.grid, len(spectrum.grid) - 1)
    forces = (
        Impulse(at=at, impulse_n_s=(1.0, 0.0, 0.0), start_s=0.0, duration_s=0.0),
        Drag(at=at, force_n=(1.0, 0.0, 0.0), start_s=0.0, duration_s=None),
        WindField(velocity_m_s=np.array([[3.0, 0.0, 0.0]]), start_s=0.0, duration_s=None),
    )
    for params, dt_s in itertools.product(pairs(InteractParams), STEPS_S):
        if params.warp:
            continue
        system = modal_system(
            spectrum,
            mass_kg=params.mass_kg,
            damping_ratio=params.damping_ratio,
            frequency_hz=params.frequency_hz,
            foliage=params.foliage,
        )
        groups = group_forces(forces, falloff_m=chosen_falloff_m(system, params))
        try:
            answer = respond(system, groups, dt_s=dt_s, num_frames=4, integrator=params.integrator)
        except UnstableTimestep:
            assert params.integrator != "exact", (params, dt_s)
        else:
            assert np.isfinite(answer.q).all(), (params, dt_s)


@pytest.mark.parametrize("period_s", [2.0, 4.17, 30.0])
def test_the_frames_of_a_file_are_counted_at_all_bounds(period_s: float) -> None:
    """A number of frames within the declared range, or an error that says what to change."""
    most = edges(ExportParams)["num_frames"][1]
    for params in pairs(ExportParams):
        try:
            count = params.count_frames(period_s)
        except InputError:
            assert params.wind_mode == "loop", params
        else:
            assert 1 <= count <= most, params


def test_a_motion_is_generated_at_all_bounds() -> None:
    """Loops of the shortest and the longest period, calm and storm, bare and in leaf: finite, and not at rest."""
    voxels, ranges = method.voxelize(tree(4.0, num_cards=20)), edges(SpectrumParams)
    winds = (Wind(speed_m_s=0.0, gust=0.0), Wind(speed_m_s=30.0, gust=1.0, direction_deg=360.0))
    for period_s, foliage, wind in itertools.product(ranges["period_s"], ranges["foliage"], winds):
        params = SpectrumParams(num_steps=1, period_s=period_s, foliage=foliage, wind=wind)
        moving = method.generate(voxels, **dict(params))
        assert np.isfinite(moving.coefficients).all()
        assert np.abs(moving.coefficients[:, 1:]).max() > 0 or wind.speed_m_s == 0
