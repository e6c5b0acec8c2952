"""A printed marker of known size gives the scale of photos that show it."""

import json
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from PIL import Image

from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.photo_requests import CutParams, PhotoParams
from dynamictree.reconstruct import ReconstructOptions, reconstruct
from dynamictree.reconstruct.marker_detection import MarkerFinder, Sighting, placed_markers
from dynamictree.reconstruct.markers import SHEET_EDGES_M, Marker, metres_per_unit
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.recut import recut
from dynamictree.reconstruct.views import View
from dynamictree.render import Camera, Renderer, RenderSettings
from recipes.marker_sheet import SHEET, marker_cells, sheet_svg
from tests.formats.meshes import written
from tests.reconstruct.conftest import SQUARE, sparse_model, stump_and_ground, textured
from tests.reconstruct.finished import write_finished

NUMBER, EDGE_M = 585, 0.1
WIDTH, HEIGHT = 640, 480
PX_PER_CELL = 24


def marker_png(number: int) -> bytes:
    cells = np.kron(marker_cells(number), np.ones((PX_PER_CELL, PX_PER_CELL), np.bool_))
    return written(Image.fromarray(np.where(cells, 245, 12).astype(np.uint8)).convert("RGB").save, format="PNG")


def with_marker(enlarged: float) -> TriangleMesh:
    """The stump, and on the ground beside it a marker, turned and a little tilted."""
    half = 0.5 * enlarged * EDGE_M * 10 / 8  # half side with the white border
    turn = np.radians(25)
    corners = half * np.array([[-1, 1, 0], [1, 1, 0.05], [1, -1, 0.05], [-1, -1, 0]])
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    corners = corners @ rotation.T + [0.8, 0.25, 0.03]
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    marker = textured(corners, SQUARE[:, ::-1], uv, marker_png(NUMBER))
    return join_meshes([*stump_and_ground(np.random.default_rng(5)), marker])


def photographed(scene: TriangleMesh, number: int, arc_deg: float) -> list[View]:
    renderer = Renderer(scene, RenderSettings(width=WIDTH, height=HEIGHT, ground=False))
    views = []
    for count in range(number):
        turn = np.radians(count * arc_deg / number - 40)
        place = np.array([2.9 * np.cos(turn), 2.9 * np.sin(turn), 1.3 + 0.3 * (count % 2)])
        camera = Camera.look_at(place, np.array([0.0, 0, 0.5]), vertical_fov_deg=38.0)
        views.append(View(source=f"{count:02d}.jpg", image=renderer.picture(camera=camera), camera=camera))
    return views


@pytest.fixture(scope="module")
def sightings() -> list[Sighting]:
    """Photos of a marker 31 to 45 pixels wide, with what is found in them."""
    finder, result = MarkerFinder(), []
    for view in photographed(with_marker(1.5), 7, 90.0):
        matrix, turn = view.camera.intrinsics_px(WIDTH, HEIGHT), view.camera.world_to_camera
        params = [matrix[0, 0], matrix[1, 1], *matrix[:2, 2]]
        camera = pycolmap.Camera(model="PINHOLE", width=WIDTH, height=HEIGHT, params=params)
        pose = pycolmap.Rigid3d(np.concatenate([turn, -(turn @ view.camera.position_m)[:, None]], axis=1))
        result.append(Sighting(camera, pose, finder.find(np.array(Image.fromarray(view.image).convert("L")))))
    return result


def test_a_marker_in_photos_has_its_size(sightings: list[Sighting]) -> None:
    assert sum(NUMBER in sighting.corners for sighting in sightings) >= 5
    [marker] = placed_markers(sightings)
    assert (marker.number, marker.num_photos >= 5) == (NUMBER, True)
    assert marker.edge == pytest.approx(1.5 * EDGE_M, rel=0.02)
    assert metres_per_unit([marker]) == pytest.approx(1 / 1.5, rel=0.02)


def test_the_scale_is_that_of_the_cameras() -> None:
    marker = Marker(number=3, edge=0.2, num_photos=9)
    model = replace(sparse_model(), markers=(marker,))
    assert model.transformed(7.0, np.eye(3), np.zeros(3)).markers == (replace(marker, edge=7 * 0.2),)


def test_a_photo_that_shows_it_elsewhere_is_left_out(sightings: list[Sighting]) -> None:
    bad = next(count for count, sighting in enumerate(sightings) if sighting.corners)
    changed = list(sightings)
    changed[bad] = changed[bad]._replace(corners={NUMBER: sightings[bad].corners[NUMBER] + [60, 0]})
    [whole], [marker] = placed_markers(sightings), placed_markers(changed)
    assert marker.num_photos == whole.num_photos - 1
    assert marker.edge == pytest.approx(whole.edge, rel=0.01)


def test_two_photos_and_what_is_no_square_are_no_marker(sightings: list[Sighting]) -> None:
    seen = [sighting for sighting in sightings if sighting.corners]
    assert placed_markers(seen[:2]) == []
    assert placed_markers([one._replace(corners={NUMBER: one.corners[NUMBER] * [1, 0.5]}) for one in seen]) == []


def test_only_markers_of_the_sheet_tell_a_scale_by_themselves() -> None:
    assert metres_per_unit([Marker(number=3, edge=0.2, num_photos=9)]) is None
    both = [Marker(number=584, edge=0.05, num_photos=9), Marker(number=586, edge=0.3, num_photos=3)]
    assert metres_per_unit(both) == pytest.approx(0.75 * 1 + 0.25 * 0.5)


def test_the_sheet_in_the_documentation_is_the_one_that_is_read() -> None:
    assert SHEET.read_text() == sheet_svg()
    for number, edge_m in SHEET_EDGES_M.items():
        assert f'width="{1000 * edge_m:g}" height="{1000 * edge_m:g}"' in sheet_svg()
        picture = 255 * np.kron(marker_cells(number), np.ones((8, 8))).astype(np.uint8)
        padded = np.pad(picture, 40, constant_values=255)
        [(seen, corners)] = MarkerFinder().find(padded).items()
        assert seen == number
        sides = np.linalg.norm(np.diff(corners, axis=0, append=corners[:1]), axis=1)
        np.testing.assert_allclose(sides, 64, atol=1)
        assert MarkerFinder().find(np.concatenate([padded, padded])) == {}


def test_a_recut_takes_the_scale_from_a_marker_of_another_size(tmp_path) -> None:
    write_finished(tmp_path / "finished")
    with pytest.raises(InputError, match="no marker was found in three photos"):
        recut(tmp_path / "finished", tmp_path / "finished", CutParams(marker_m=0.2))
    report = json.loads((tmp_path / "finished" / "report.json").read_text())
    report["markers"] = [{"number": 3, "edge_m": 0.5, "num_photos": 4}]
    (tmp_path / "finished" / "report.json").write_text(json.dumps(report))
    (tmp_path / "metric").mkdir()
    capture = recut(tmp_path / "finished", tmp_path / "metric", CutParams(marker_m=0.2))
    assert capture.mesh.height_m == pytest.approx(1.3 * 0.2 / 0.5, rel=1e-5)
    metric = json.loads((tmp_path / "metric" / "report.json").read_text())
    assert metric["scale"] == "marker"
    assert metric["markers"][0]["edge_m"] == pytest.approx(0.2)
    recut(tmp_path / "metric", tmp_path / "metric", CutParams(only_plant=False))
    assert json.loads((tmp_path / "metric" / "report.json").read_text())["scale"] == "marker"


@pytest.mark.parametrize("model", [CutParams, PhotoParams])
def test_height_and_marker_are_not_both_given(model: type[CutParams] | type[PhotoParams]) -> None:
    with pytest.raises(InputError, match="height_m and marker_m both give the scale"):
        model(height_m=1.0, marker_m=0.1)
    with pytest.raises(InputError, match="marker_m is 0"):
        model(marker_m=0.0)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_photos_with_a_marker_become_a_plant_of_its_true_height(tmp_path) -> None:
    """Cameras are found, so their unit is any; the stump is 1.2 m high above the ground and twice as large as life."""
    for view in photographed(with_marker(2.0), 14, 360.0):
        Image.fromarray(view.image).save(tmp_path / view.source, quality=95)
    out = tmp_path / "out"
    out.mkdir()
    schedule = Schedule(num_steps=100, side_px=320, check_every=50)
    photos = sorted(tmp_path.glob("*.jpg"))
    result = reconstruct(photos, out, options=ReconstructOptions(schedule=schedule))
    assert result.report["scale"] == "marker"
    [marker] = result.report["markers"]
    assert marker["edge_m"] == pytest.approx(EDGE_M, rel=1e-6)
    positions = np.array([view.camera.position_m for view in result.cameras])
    radius_m = np.linalg.norm(positions[:, :2] - positions[:, :2].mean(axis=0), axis=1).mean()
    assert radius_m == pytest.approx(2.9 / 2, rel=0.02)
    assert result.report["height_m"] == pytest.approx(0.6, rel=0.06)  # the mesh begins above the ground
