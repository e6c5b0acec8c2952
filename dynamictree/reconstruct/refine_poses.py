"""Refine given poses by bundle adjustment if the photos disagree with them; runs in the process of `mapping`."""

from collections.abc import Callable

import numpy as np
import pycolmap
from jaxtyping import Float64

ENOUGH_PX = 0.5
"""Mean reprojection error up to which given cameras are left unchanged."""

ENOUGH_POINTS = 50
"""Points that a photo must see for its pose to be adjusted; the few points of thin plants are often wrong."""


Triangulate = Callable[[pycolmap.Reconstruction, float], pycolmap.Reconstruction]


def refine_poses(
    model: pycolmap.Reconstruction, positions: dict[str, Float64[np.ndarray, "3"]], triangulate: Triangulate
) -> pycolmap.Reconstruction:
    """Adjust poses if the mean reprojection error exceeds 0.5 px; if it still does, also focal lengths and distortion.

    The given positions fix frame and scale. Points are triangulated again after each round, since with wrong poses few
    agree. A photo that sees fewer than 50 points keeps its given pose.

    Args:
        model: model triangulated with the given cameras.
        positions: given camera positions by image name.
        triangulate: triangulates a model's points with fixed cameras; the number multiplies COLMAP's thresholds.
    """
    for lenses in (False, True):
        if model.compute_mean_reprojection_error() > ENOUGH_PX and model.num_points3D() > 0:
            model = _best(model, positions, triangulate, lenses=lenses)
    return model


def _best(
    model: pycolmap.Reconstruction,
    positions: dict[str, Float64[np.ndarray, "3"]],
    triangulate: Triangulate,
    *,
    lenses: bool,
) -> pycolmap.Reconstruction:
    """Alternate bundle adjustment and triangulation until the error no longer falls."""
    slack = 4.0  # initial factor of COLMAP's thresholds; strict ones leave a misplaced photo hardly any points
    least_gain = 0.95  # ratio of errors above which to stop
    max_rounds = 8
    error_px = model.compute_mean_reprojection_error()
    start = triangulate(pycolmap.Reconstruction(model), slack)
    for _ in range(max_rounds):
        if not _well_seen(start):
            break
        adjusted = triangulate(_adjusted(start, positions, lenses=lenses), 1.0)
        adjusted_px = adjusted.compute_mean_reprojection_error()
        gained = adjusted.compute_num_observations() > model.compute_num_observations()
        if adjusted_px > least_gain * error_px and not gained:
            break
        model = start = adjusted
        error_px = adjusted_px
    return model


def _well_seen(model: pycolmap.Reconstruction) -> set[int]:
    """Return the images that see enough points."""
    return {image.image_id for image in model.images.values() if image.num_points3D >= ENOUGH_POINTS}


def _adjusted(
    model: pycolmap.Reconstruction, positions: dict[str, Float64[np.ndarray, "3"]], *, lenses: bool
) -> pycolmap.Reconstruction:
    prior_share = 0.1  # standard deviation of given positions [cameras' spread]; weak, so photos dominate
    model = pycolmap.Reconstruction(model)
    config = pycolmap.BundleAdjustmentConfig()
    priors = []
    places = np.array(list(positions.values()))
    deviation = prior_share * float(np.linalg.norm(places - places.mean(axis=0), axis=1).mean())
    adjustable = _well_seen(model)
    for image in model.images.values():
        config.add_image(image.image_id)
        if image.image_id not in adjustable:
            config.set_constant_rig_from_world_pose(image.frame_id)
            continue
        prior = pycolmap.PosePrior(
            position=positions[image.name],
            position_covariance=deviation**2 * np.eye(3),
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        prior.corr_data_id = image.data_id
        priors.append(prior)
    options, prior_options = pycolmap.BundleAdjustmentOptions(), pycolmap.PosePriorBundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = lenses
    options.print_summary = False
    pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, model).solve()
    return model
