"""Each view looks as it did: small pictures of one tree in `goldens/`, with a tolerance.

`GOLDENS=write` takes them anew; look at them before they are committed.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from tests.browser.conftest import PICTURES, Open, scrub, steady

GOLDENS = Path(__file__).with_name("goldens")
WIDTH = 160
BLUR_PX = 1.0  # another machine draws an edge elsewhere by less
TOLERANCE = 2.0  # root mean square over pixels and colours [0 to 255]; WebP alone makes up to 1.5
VIEWS = ("surface", "wire", "voxels", "modes")
COMPANY = ("pair", "forest")
SIZES = {"desktop": (1100, 720), "phone": (390, 760)}


def small(picture: np.ndarray) -> np.ndarray:
    """As goldens are stored."""
    image = Image.fromarray(picture.astype(np.uint8))
    return np.asarray(image.resize((WIDTH, round(WIDTH * image.height / image.width)), Image.Resampling.BOX))


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square of the colours, a little blurred."""
    blurred = [
        np.asarray(Image.fromarray(each).filter(ImageFilter.GaussianBlur(BLUR_PX)), float) for each in (one, other)
    ]
    return float(np.sqrt(((blurred[0] - blurred[1]) ** 2).mean()))


def compare(name: str, picture: np.ndarray) -> str:
    """What is wrong with a view, or nothing."""
    now, path = small(picture), GOLDENS / f"{name}.webp"
    if os.environ.get("GOLDENS") == "write":
        GOLDENS.mkdir(exist_ok=True)
        Image.fromarray(now).save(path, quality=90, method=6)
    with Image.open(path) as image:
        golden = np.asarray(image.convert("RGB"))
    if golden.shape != now.shape:
        return f"{name}: {now.shape[1]} × {now.shape[0]}, not {golden.shape[1]} × {golden.shape[0]}"
    off = difference(now, golden)
    if off <= TOLERANCE:
        return ""
    Image.fromarray(np.concatenate([golden, now], axis=1)).save(PICTURES / f"golden-{name}.png")
    return f"{name}: off by {off:.1f} of 255, more than {TOLERANCE}; golden and now are in {PICTURES}/golden-{name}.png"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_every_view_looks_as_it_did(view: Open, url: str, job_id: str, size: str, scheme: str) -> None:
    width, height = SIZES[size]
    viewer = view(width, height, scheme=scheme, touch=size == "phone")
    page = viewer.page
    viewer.show(f"{url}/#job={job_id}")
    page.locator("#play").click()
    steady(viewer)
    wrong = []
    for kind in VIEWS:
        page.locator(f"#views input[value={kind}]").check(force=True)
        scrub(viewer, 0.25)
        wrong.append(compare(f"{kind}-{size}-{scheme}", steady(viewer)))
    page.locator("#views input[value=surface]").check(force=True)
    for company in COMPANY:
        page.locator(f"#company input[value={company}]").check(force=True)
        scrub(viewer, 0.25)
        wrong.append(compare(f"{company}-{size}-{scheme}", steady(viewer)))
    assert not list(filter(None, wrong))


def test_a_view_without_its_tree_differs_from_the_golden() -> None:
    for path in GOLDENS.glob("*.webp"):
        with Image.open(path) as image:
            golden = np.asarray(image.convert("RGB"))
        sky = np.broadcast_to(np.median(golden, axis=1, keepdims=True), golden.shape).astype(np.uint8)
        assert difference(sky, golden) > 2 * TOLERANCE, path.name
