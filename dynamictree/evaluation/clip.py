"""CLIP-I and CLIP-T, paper section 6: how far frames are from the input view, and from one another, for ViT-B/32.

The image tower is `transformers`' (extra `evaluate`); its weights are the user's own file, nothing is fetched.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Complex64, Float32, UInt8
from PIL import Image
from safetensors import SafetensorError, safe_open
from torch import Tensor

from dynamictree.errors import CheckpointError, InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.render import Camera, Look, Renderer
from dynamictree.spectrum import NUM_FRAMES, iter_motion

if TYPE_CHECKING:
    from transformers import CLIPVisionModelWithProjection

SIDE_PX = 224
MEAN = (0.48145466, 0.4578275, 0.40821073)  # of the pictures that CLIP was trained on
DEVIATION = (0.26862954, 0.26130258, 0.27577711)
TOWER = ("vision_model.", "visual_projection.")
BATCH = 16


class ImageEmbedder:
    """CLIP image tower: pictures to unit vectors."""

    def __init__(self, network: "CLIPVisionModelWithProjection") -> None:
        self.network = network.train(mode=False).requires_grad_(False)

    def embed(self, pictures: Iterable[UInt8[np.ndarray, "_ _ 3"]]) -> Float32[Tensor, "P D"]:
        """One row a picture; pictures are taken as they come, a batch at a time."""
        rows, waiting = [], []
        for picture in pictures:
            waiting.append(_pixels(picture))
            if len(waiting) == BATCH:
                rows.append(self._embed(waiting))
                waiting = []
        if waiting:
            rows.append(self._embed(waiting))
        return torch.cat(rows)

    def _embed(self, pixels: list[Float32[Tensor, "3 S S"]]) -> Float32[Tensor, "P D"]:
        with torch.no_grad():
            embedded: Tensor = self.network(pixel_values=torch.stack(pixels)).image_embeds
        return torch.nn.functional.normalize(embedded, dim=1)


def load_clip(path: Path) -> ImageEmbedder:
    """ViT-B/32 from a file, or a folder that holds `model.safetensors`; a text tower beside it is left alone.

    Raises:
        InputError: no such file, or `transformers` is not installed.
        CheckpointError: not the weights of CLIP's ViT-B/32.
    """
    file = path / "model.safetensors" if path.is_dir() else path
    wanted = "give model.safetensors of openai/clip-vit-base-patch32"
    if not file.is_file():
        raise InputError(f"there is no file {file}; {wanted}")
    try:
        from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection
    except ImportError as error:
        raise InputError("CLIP needs the package transformers; install dynamictree[evaluate]") from error
    try:
        with safe_open(file, framework="pt") as stored:
            names = [name for name in stored.keys() if name.startswith(TOWER)]  # noqa: SIM118 no mapping
            weights = {name: stored.get_tensor(name).float() for name in names if not name.endswith("position_ids")}
    except SafetensorError as error:
        raise CheckpointError(f"{file} is no safetensors file ({error}); {wanted}") from error
    with torch.device("meta"):
        network = CLIPVisionModelWithProjection(CLIPVisionConfig())  # by default, ViT-B/32
    needed = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    shapes = {name: tuple(value.shape) for name, value in weights.items()}
    if needed != shapes:
        wrong = sorted(name for name in needed.keys() | shapes if needed.get(name) != shapes.get(name))
        raise CheckpointError(f"{file} differs from ViT-B/32 in {len(wrong)} tensors, first {wrong[0]!r}; {wanted}")
    # positions are no weights and were not stored: the network is made in memory, then given its weights
    network = CLIPVisionModelWithProjection(CLIPVisionConfig())
    network.load_state_dict(weights)
    return ImageEmbedder(network)


def clip_distances(
    embedder: ImageEmbedder, view: UInt8[np.ndarray, "H W 3"], frames: Iterable[UInt8[np.ndarray, "_ _ 3"]]
) -> tuple[float, float]:
    """CLIP-I and CLIP-T: 1 − cosine, the mean over frames to the input view and to the frame before."""
    (seen,) = embedder.embed([view])
    rows = embedder.embed(frames)
    return float(1 - (rows @ seen).mean()), float(1 - (rows[1:] * rows[:-1]).sum(dim=1).mean())


def motion_distances(
    embedder: ImageEmbedder,
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    *,
    num_frames: int = NUM_FRAMES,
) -> tuple[float, float]:
    """CLIP-I and CLIP-T of a motion of a mesh; the input view is the tree at rest from where the frames are seen."""
    renderer = Renderer(mesh, Look(width=SIDE_PX, height=SIDE_PX))
    camera = Camera.orbit(mesh.vertices, aspect=1.0)
    return clip_distances(
        embedder, renderer.picture(camera=camera), _frames(renderer, camera, coefficients, num_frames)
    )


def _frames(
    renderer: Renderer, camera: Camera, coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    for displacement in iter_motion(coefficients, np.arange(num_frames) / num_frames):
        yield renderer.picture(displacement, camera=camera)


def _pixels(picture: UInt8[np.ndarray, "H W 3"]) -> Float32[Tensor, "3 S S"]:
    """Preprocess a picture for CLIP: centre square, 224², colours normalised."""
    height, width = picture.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = Image.fromarray(picture[top : top + side, left : left + side])
    if side != SIDE_PX:
        square = square.resize((SIDE_PX, SIDE_PX), Image.Resampling.BICUBIC)
    scaled = np.asarray(square, np.float32) / 255
    normal = (scaled - np.array(MEAN, np.float32)) / np.array(DEVIATION, np.float32)
    return torch.from_numpy(np.ascontiguousarray(normal.transpose(2, 0, 1)))
