"""Why photos got no camera, from what COLMAP's database holds of them; runs in the process of `mapping`."""

from collections.abc import Container

import pycolmap

_FEW_FEATURES = 200
_FEW_SHARED = 30  # COLMAP places a photo by at least so many points that it shares with others


def reasons(database: pycolmap.Database, placed: Container[str]) -> dict[str, str]:
    """A sentence for each photo that is not `placed`, by its name in the database."""
    images = database.read_all_images()
    others = [image.image_id for image in images if image.name in placed]
    pairs = dict(zip(*database.read_two_view_geometry_num_inliers(), strict=True))
    sentences = {}
    for image in images:
        if image.name in placed:
            continue
        numbers = (pairs.get(pycolmap.image_pair_to_pair_id(image.image_id, other), 0) for other in others)
        sentences[image.name] = _reason(database.num_keypoints_for_image(image.image_id), max(numbers, default=0))
    return sentences


def _reason(num_features: int, num_shared: int) -> str:
    if num_features < _FEW_FEATURES:
        return f"it has {num_features} features; {_FEW_FEATURES} are few: it is blurred, dark or plain"
    if num_shared < _FEW_SHARED:
        return (
            f"it shares {num_shared} points with the photo most like it; {_FEW_SHARED} are needed: "
            "it was taken from too far aside, or shows something else"
        )
    return (
        f"it shares {num_shared} points with another photo and fits at no place: something moved, looks "
        "alike twice, or only what is far away is seen in both"
    )
