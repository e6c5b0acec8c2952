"""Photos as the program that finds cameras leaves them."""

import json

import numpy as np
import pytest
from PIL import Image

from dynamictree.reconstruct.views import read_model

WIDTH, HEIGHT = 300, 200
PLACE = np.array([0.3, -0.2, 2.0])


@pytest.mark.parametrize("focal_px", [(250.0, 250.0), (250.0, 200.0), (200.0, 260.0)])
def test_a_point_is_where_the_photo_shows_it(tmp_path, focal_px: tuple[float, float]) -> None:
    x, y = np.array([140.0, 110.0]) + np.array(focal_px) * PLACE[:2] / PLACE[2]
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[int(y) - 3 : int(y) + 4, int(x) - 3 : int(x) + 4] = 255
    for folder in ("undistorted", "undistorted-masks"):
        (tmp_path / folder / "images").mkdir(parents=True)
        Image.fromarray(picture).save(tmp_path / folder / "images" / "0.png")
    view = {
        "name": "0.png",
        "rotation": np.eye(3).tolist(),
        "translation": [0.0, 0.0, 0.0],
        "width": WIDTH,
        "height": HEIGHT,
        "focal_px": focal_px,
        "principal_px": [140.0, 110.0],
    }
    (tmp_path / "views.json").write_text(
        json.dumps({"reprojection_error_px": 0.1, "views": [view], "left_out": {}, "markers": []})
    )
    np.savez(
        tmp_path / "points.npz",
        positions=PLACE[None],
        colors=np.zeros((1, 3), np.uint8),
        seen=np.zeros((1, 2), np.int64),
    )
    model = read_model(tmp_path, {"0.png": "IMG_0.png"})
    [read] = model.views
    height, width = read.alpha.shape
    [[column, row, _]] = read.camera.project(PLACE[None], width, height)
    for drawn in (read.image[..., 0], read.alpha):
        rows, columns = np.nonzero(drawn > 128)
        np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], [column, row], atol=1.0)
