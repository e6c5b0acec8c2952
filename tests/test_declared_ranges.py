"""A declared range is a promise: every bound of a request works together with the bounds of each other field."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from dynamictree import method
from dynamictree.errors import InputError
from dynamictree.requests import ExportParams, Request, SpectrumParams, Wind
from tests.plant.stand import tree


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


def pairs(model: type[Request]) -> Iterator[Any]:
    """Requests in which two fields are at bounds, for each pair of fields and of their bounds."""
    for (first, ours), (second, theirs) in itertools.combinations(edges(model).items(), 2):
        for one, other in itertools.product(ours, theirs):
            yield model.model_validate({first: one, second: other})


def test_the_frames_of_a_file_are_counted_at_all_bounds() -> None:
    """A number of frames within the declared range, or an error that says what to change."""
    most = edges(ExportParams)["num_frames"][1]
    for params, period_s in itertools.product(pairs(ExportParams), (2.0, 4.17, 30.0)):
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
