"""One request, written down once: the models, the command line and the HTTP bodies agree."""

import inspect
import subprocess
import sys
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from dynamictree.cli import Commands
from dynamictree.errors import InputError
from dynamictree.photo_requests import CutParams, PhotoParams
from dynamictree.requests import (
    MAX_FIRST_FRAME,
    MAX_FRAMES,
    MAX_TURBULENT_FILM_FRAMES,
    MAX_TURBULENT_FRAMES,
    AnimateParams,
    CloudParams,
    ExportParams,
    Format,
    GeneratorGridParams,
    InteractParams,
    ModelParams,
    Reading,
    Request,
    Shot,
    SpectrumParams,
    Wind,
)

OWN_OPTIONS = {
    "animate": {"source", "output", "mask", "mesh", "as_json"},
    "recut": {"source", "output", "as_json"},
    "reconstruct": {"photos", "output", "fresh", "as_json"},
    "interact": {"spectrum", "output", "mesh", "formats", "as_json"}
    | {"impulse", "force", "displacement", "wind", "point", "voxel", "radius", "start", "duration", "held"}
    | {"frames", "fps"},
}


def names(*models: type[Request]) -> set[str]:
    """Every field, those of wind and shot in place of the field that holds them."""
    fields = {name for model in models for name in model.model_fields}
    if "wind" in fields:
        fields = fields - {"wind"} | {"speed_m_s", "direction_deg", "gust"}
    if "shot" in fields:
        fields = fields - {"shot"} | set(Shot.model_fields)
    return fields


@pytest.mark.parametrize(
    ("command", "models"),
    [
        ("animate", (ExportParams, CloudParams, GeneratorGridParams, ModelParams, SpectrumParams, Reading)),
        ("reconstruct", (PhotoParams,)),
        ("recut", (CutParams,)),
        ("interact", (InteractParams, Reading)),
    ],
)
def test_a_command_has_one_option_per_field(command: str, models: tuple[type[Request], ...]) -> None:
    options = {parameter.name: parameter for parameter in Commands()[command].params}
    assert set(options) == names(*models) | OWN_OPTIONS[command]
    schema = AnimateParams.model_json_schema()
    for name, field in (schema["properties"] | schema["$defs"]["Shot"]["properties"]).items():
        if name in names(*models) and field.get("type") not in ("array", None):
            assert options[name].default == field["default"], name


def test_the_help_of_an_option_has_its_unit_and_range() -> None:
    options = {parameter.name: parameter for parameter in Commands()["animate"].params}
    for name, unit, allowed in [
        ("speed_m_s", r"\[m/s]", "0 to 30."),
        ("first_frame", "", f"0 to {MAX_FIRST_FRAME}."),
        ("share", "", "Above 0 and at most 1."),
        ("resolution", "", "128, 256 or 512."),
        ("formats", "", "splat, png, webp, mp4."),
    ]:
        assert unit in options[name].help
        assert options[name].help.endswith(allowed), name


@pytest.mark.parametrize(("text", "axis"), [("z", "+Z"), ("-y", "-Y"), ("X", "+X"), ("+Z", "+Z")])
def test_an_up_axis_may_lack_its_sign_and_its_capital(text: str, axis: str) -> None:
    assert Reading(up_axis=text).up_axis == axis


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"fps": 0.5}, "fps is 0.5: it should be greater than or equal to 1"),
        ({"speed": float("nan")}, "speed is nan"),
        ({"shot": {"side_px": 63}}, "shot.side_px is 63"),
        ({"wind": {"gust": 3}}, "wind.gust is 3"),
        ({"frames": 3}, "there is no parameter frames"),
        ({"fps": 0, "share": 2}, "share is 2"),
    ],
)
def test_a_wrong_value_is_an_input_error_in_python_and_has_its_place_in_a_body(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as raised:
        AnimateParams(**fields)
    assert message in str(raised.value)
    with pytest.raises(ValidationError) as refused:
        TypeAdapter(AnimateParams).validate_python(fields)
    places = {".".join(map(str, error["loc"])) for error in refused.value.errors()}
    assert message.removeprefix("there is no parameter ").split()[0] in places


def test_a_part_of_a_request_takes_its_own_fields() -> None:
    whole = AnimateParams(num_steps=3, wind=Wind(speed_m_s=7.0), fps=30.0).model_dump(mode="json")
    assert SpectrumParams.part_of(whole) == SpectrumParams(num_steps=3, wind=Wind(speed_m_s=7.0))
    assert SpectrumParams.part_of({}) == SpectrumParams()


@pytest.mark.parametrize(
    ("params", "count"),
    [(ExportParams(), 100), (ExportParams(num_frames=200), 200), (ExportParams(num_frames=7, loop=False), 7)],
)
def test_frames_are_counted_in_whole_periods(params: ExportParams, count: int) -> None:
    assert params.count_frames(100 / 24) == count


@pytest.mark.parametrize(
    ("params", "message"),
    [
        (ExportParams(num_frames=150), "100 or 200 frames make a loop"),
        (ExportParams(num_frames=1, speed=0.9), "no number of frames|frames make a loop"),
        (ExportParams(fps=240.0, speed=0.5), "one period is 2000 frames"),
        (ExportParams(num_frames=MAX_FRAMES + 100), "num_frames is 1100.*wind_mode turbulent"),
    ],
)
def test_frames_that_would_jump_are_refused(params: ExportParams, message: str) -> None:
    with pytest.raises(InputError, match=message):
        params.count_frames(100 / 24)


def test_turbulent_wind_needs_no_whole_period_and_lasts_ten_minutes() -> None:
    assert ExportParams(wind_mode="turbulent").count_frames(100 / 24) == 240
    assert ExportParams(wind_mode="turbulent", num_frames=MAX_TURBULENT_FRAMES).count_frames(100 / 24) == 14_400
    assert ExportParams(wind_mode="turbulent").chosen_formats(cloud=False) == ("ply", "png")
    assert ExportParams().chosen_formats(cloud=False) == ("ply", "glb", "png")
    assert ExportParams(formats=("glb-skinned",)).formats == ("glb",)  # its older name


@pytest.mark.parametrize(
    ("name", "num_frames", "message"),
    [
        ("glb", 100, "glb holds one period and no turbulent motion: take ply"),
        ("splat", 100, "splat holds one period"),
        ("usd", MAX_FRAMES + 1, f"num_frames is {MAX_FRAMES + 1}; at most {MAX_FRAMES}"),
        ("mp4", MAX_TURBULENT_FILM_FRAMES + 1, "at most 3600 are allowed of a turbulent motion as mp4"),
    ],
)
def test_a_format_that_cannot_hold_a_turbulent_motion_is_refused(name: Format, num_frames: int, message: str) -> None:
    params = ExportParams(wind_mode="turbulent", num_frames=num_frames, formats=(name,))
    with pytest.raises(InputError, match=message):
        params.chosen_formats(cloud=False)
    assert ExportParams(formats=(name,)).chosen_formats(cloud=False) == (name,)


def test_requests_need_pydantic_alone() -> None:
    program = (
        "import sys, dynamictree; print('pydantic' in sys.modules); import dynamictree.requests; print(*sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    before, *loaded = answer.split()
    assert before == "False"
    assert not {"numpy", "torch", "numba", "fastapi", "typer"} & set(loaded)


def test_every_parameter_is_described() -> None:
    for model in [Request, *Request.__subclasses__()]:
        for name, field in model.model_fields.items():
            assert field.description or inspect.isclass(field.annotation), f"{model.__name__}.{name}"
