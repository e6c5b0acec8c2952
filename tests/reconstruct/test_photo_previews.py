"""Previews of photos: names, and the same shares of width and height as a stroke's."""

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors import safe_open

from dynamictree.reconstruct.photo_previews import MOST_PHOTOS, SIDE_PX, write_photo_previews
from dynamictree.reconstruct.views import View
from dynamictree.render import Camera

CAMERA = Camera.look_at(np.array([3.0, 0, 1]), np.zeros(3), vertical_fov_deg=40.0)


def views(number: int, width: int, height: int) -> list[View]:
    """Grey photos with a white square around 0.75, 0.25 of each, the n-th as grey as its number."""
    pictures = []
    for grey in range(number):
        image = np.full((height, width, 3), grey, np.uint8)
        image[int(0.2 * height) : int(0.3 * height), int(0.7 * width) : int(0.8 * width)] = 255
        pictures.append(View(source=f"{grey:03d}.jpg", image=image, camera=CAMERA))
    return pictures


def read(folder: Path) -> tuple[list[str], list[np.ndarray]]:
    with safe_open(folder / "photos.safetensors", "np") as file:
        names = json.loads(file.metadata()["photos"])
        pictures = [file.get_tensor(f"photo_{number}").tobytes() for number in range(len(names))]
        assert len(file.keys()) == len(names)
    return names, [np.asarray(Image.open(BytesIO(content))) for content in pictures]


@pytest.mark.parametrize(("width", "height"), [(2400, 1600), (900, 1200), (320, 240)])
def test_a_place_is_the_same_share_of_the_preview(tmp_path, width: int, height: int) -> None:
    write_photo_previews(views(3, width, height), tmp_path)
    names, pictures = read(tmp_path)
    assert names == ["000.jpg", "001.jpg", "002.jpg"]
    for picture in pictures:
        assert max(picture.shape) == min(SIDE_PX, max(width, height))
        rows, columns = np.nonzero(picture.mean(axis=2) > 128)
        place = (columns.mean() + 0.5) / picture.shape[1], (rows.mean() + 0.5) / picture.shape[0]
        np.testing.assert_allclose(place, (0.75, 0.25), atol=0.004)


def test_of_many_photos_some_are_written_evenly(tmp_path) -> None:
    write_photo_previews(views(100, 320, 240), tmp_path)
    names, pictures = read(tmp_path)
    numbers = np.array([int(name[:3]) for name in names])
    assert len(numbers) == MOST_PHOTOS
    assert (numbers[0], numbers[-1]) == (0, 99)
    assert set(np.diff(numbers)) <= {4, 5}
    assert [int(np.median(picture)) for picture in pictures] == pytest.approx(numbers, abs=3)


def test_the_same_photos_give_the_same_bytes(tmp_path) -> None:
    contents = set()
    for _ in range(8):
        write_photo_previews(views(3, 40, 30), tmp_path)
        contents.add((tmp_path / "photos.safetensors").read_bytes())
    assert len(contents) == 1
