from io import BytesIO

import numpy as np
from PIL import Image

from dynamictree.mesh import Material
from dynamictree.render import amplitude_colors, sway_amplitude
from dynamictree.render.contact_sheet import _whitened
from dynamictree.spectrum import to_motion


def test_sway_is_the_root_mean_square_about_the_mean_place(rng):
    coefficients = (rng.normal(size=(7, 16, 3)) + 1j * rng.normal(size=(7, 16, 3))).astype(np.complex64)
    coefficients[:, 0] = coefficients[:, 0].real
    motion = to_motion(coefficients, 100)
    rms = np.sqrt(((motion - motion.mean(axis=0)) ** 2).sum(axis=2).mean(axis=0))
    assert np.allclose(sway_amplitude(coefficients, 100), rms, rtol=1e-5)


def test_what_stands_still_is_grey():
    colors = amplitude_colors(np.float32([0.0, 0.5, 1.0]), np.array([True, False, False])).astype(int)
    assert np.ptp(colors[0, :3]) < 10
    assert (colors[1:] == amplitude_colors(np.float32([0.0, 0.5, 1.0]))[1:]).all()


def test_the_sway_in_colours_takes_a_texture_for_its_outline_alone():
    picture = Image.new("RGBA", (4, 4), (10, 80, 20, 255))
    picture.putpixel((0, 0), (200, 0, 0, 0))
    content = BytesIO()
    picture.save(content, "png")
    leaf = _whitened(Material(texture_png=content.getvalue(), alpha_cutoff=0.5, base_color=(0.1, 0.3, 0.1, 1.0)))
    seen = np.asarray(Image.open(BytesIO(leaf.texture_png)).convert("RGBA"))
    assert (seen[..., :3] == 255).all()
    assert seen[0, 0, 3] == 0
    assert (seen[1:, :, 3] == 255).all()
    assert leaf.base_color == (1.0, 1.0, 1.0, 1.0)
