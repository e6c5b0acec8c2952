"""Last level of detail: upright cards with a picture of the tree, which move with the tree."""

import io
from dataclasses import replace

import numpy as np
from jaxtyping import Complex64, Float64
from PIL import Image

from dynamictree.mesh import Material, MeshLook, TriangleMesh
from dynamictree.render import Camera, Renderer, RenderSettings

CARD_VIEWS_DEG = (0.0, 90.0)
MOST_SAMPLES = 200_000  # vertices at which motions are compared or averaged


def cards_of(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"]
) -> tuple[TriangleMesh, Complex64[np.ndarray, "M K 3"]]:
    """Return upright cards that cross at the tree's axis, one per view, and their spectra, averaged over the tree's."""
    card_rows, card_columns = 6, 4  # quads of a card
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
    middle, height = (low + high) / 2, float(high[2] - low[2])
    half = float(np.abs(mesh.vertices[:, :2] - middle[:2]).max())
    vertices, uv, faces = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    lines = np.meshgrid(np.linspace(0, 1, card_columns + 1), np.linspace(0, 1, card_rows + 1))
    column, row = lines[0].ravel(), lines[1].ravel()
    corner = np.arange(card_rows * (card_columns + 1)).reshape(card_rows, -1)[:, :-1].ravel()
    above = corner + card_columns + 1
    quads = np.concatenate([np.stack([corner, corner + 1, above + 1], 1), np.stack([corner, above + 1, above], 1)])
    for number, azimuth in enumerate(np.radians(CARD_VIEWS_DEG)):
        across = np.array([np.cos(azimuth), np.sin(azimuth)])
        place = middle[:2] + np.outer((2 * column - 1) * half, across)
        vertices.append(np.column_stack([place, low[2] + row * height]))
        uv.append(np.column_stack([(number + column) / len(CARD_VIEWS_DEG), 1 - row]))
        faces.append(quads + number * len(column))
    picture = Material(
        name="impostor",
        base_color=(1.0, 1.0, 1.0, 1.0),
        texture_png=_card_picture(mesh, middle, half, height),
        alpha_cutoff=0.5,
        double_sided=True,
    )
    places = np.concatenate(vertices)
    cards = TriangleMesh(
        vertices=places.astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        look=MeshLook(
            uv=np.concatenate(uv).astype(np.float32),
            face_material=np.zeros(len(quads) * len(CARD_VIEWS_DEG), np.int32),
            materials=(picture,),
        ),
    )
    return cards, _mean_motion(mesh, coefficients, places, height / card_rows)


def _mean_motion(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"], places: Float64[np.ndarray, "P 3"], reach_m: float
) -> Complex64[np.ndarray, "P K 3"]:
    """Return the mean motion of the vertices around each place, weighted by nearness."""
    from scipy.spatial.distance import cdist

    some = slice(None, None, -(-mesh.num_vertices // MOST_SAMPLES))
    coefficients = coefficients[some]
    distance = cdist(places, mesh.vertices[some].astype(np.float64), "sqeuclidean")  # [P, N]
    weight = np.exp((distance.min(axis=1, keepdims=True) - distance) / (2 * (reach_m / 2) ** 2))
    weight /= weight.sum(axis=1, keepdims=True)
    flat = weight.astype(np.float32) @ coefficients.reshape(len(coefficients), -1)
    return np.asarray(flat.reshape(len(places), *coefficients.shape[1:]).astype(np.complex64))


def _card_picture(mesh: TriangleMesh, middle: Float64[np.ndarray, "3"], half: float, height: float) -> bytes:
    """Render the views of all cards side by side as PNG, cut out along the tree's outline."""
    far = 40.0  # distance of the card's camera over the tree's height: nearly parallel rays
    card_px = 512  # height of the picture on a card
    width = max(16, round(card_px * 2 * half / height / 16) * 16)
    look = RenderSettings(width=min(width, 4 * card_px), height=card_px, ground=False)
    renderer = Renderer(mesh, look)
    fine = Renderer(mesh, replace(look, width=2 * look.width, height=2 * look.height, shadows=False))
    views = []
    for azimuth in np.radians(CARD_VIEWS_DEG):
        away = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0]) * far * height
        angle = float(np.degrees(2 * np.arctan(0.5 / far)))
        camera = Camera.look_at(middle + away, middle, vertical_fov_deg=angle)
        covered = (fine.buffers(camera).face >= 0).astype(np.float32)
        alpha = covered.reshape(look.height, 2, look.width, 2).mean(axis=(1, 3))
        views.append(np.dstack([renderer.picture(camera=camera), np.round(255 * alpha).astype(np.uint8)]))
    stream = io.BytesIO()
    Image.fromarray(np.concatenate(views, axis=1)).save(stream, "PNG")
    return stream.getvalue()
