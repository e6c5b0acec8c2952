"""Distances of frames for EfficientNet-Lite0: a motion that is no motion of that tree is farther from the truth."""

import numpy as np
import pytest

from dynamictree.render import Camera, Look, Renderer
from dynamictree.spectrum import NUM_FRAMES, iter_motion
from lab.dataset.sample import make_sample
from lab.evaluation.frame_distances import SIDE_PX, distance_error, frame_distances, motion_distances

pytest.importorskip("efficientnet_lite_pytorch", reason="the extra `evaluate` is not installed")

NUM_DRAWN = 12


@pytest.mark.slow
def test_torn_shuffled_and_frozen_motions_are_farther_from_the_truth_than_another_wind() -> None:
    from lab.evaluation.effnet import load_effnet

    embedder = load_effnet()
    sample = make_sample(3, "columnar")
    mesh, rng = sample.mesh, np.random.default_rng(0)
    renderer = Renderer(mesh, Look(width=SIDE_PX, height=SIDE_PX))
    camera = Camera.orbit(mesh.vertices, aspect=1.0)
    frames = list(iter_motion(sample.coefficients, np.arange(NUM_DRAWN) / NUM_FRAMES))
    later = list(iter_motion(sample.coefficients, (40 + np.arange(NUM_DRAWN)) / NUM_FRAMES))
    size = float(np.sqrt(np.mean(np.square(frames))))
    kinds = {
        "true": frames,
        "true, later": later,
        "shuffled": [frames[i] for i in rng.permutation(NUM_DRAWN)],
        "torn": [frame + rng.normal(0, size, frame.shape).astype(np.float32) for frame in frames],
        "frozen": frames[:1] * NUM_DRAWN,
    }
    rest = renderer.picture(camera=camera)
    seen = {
        kind: frame_distances(embedder, rest, [renderer.picture(one, camera=camera) for one in some])
        for kind, some in kinds.items()
    }
    errors = {kind: distance_error(one, seen["true"]) for kind, one in seen.items()}
    assert errors["true"] == 0
    assert errors["true, later"] < min(errors["shuffled"], errors["torn"], errors["frozen"])


def test_a_tree_that_does_not_move_is_at_no_distance() -> None:
    from lab.evaluation.effnet import load_effnet

    sample = make_sample(3, "sapling")
    still = motion_distances(load_effnet(), sample.mesh, np.zeros_like(sample.coefficients), num_frames=2)
    assert still == pytest.approx((0, 0), abs=1e-5)
