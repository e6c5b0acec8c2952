"""Dense depth by PatchMatch stereo (Bleyer 2011; checkerboard of Galliani 2015), on the CPU.

A hypothesis is the inverse depth at a pixel and its change per pixel to the right and down. Inverse depth is affine in
the picture of a plane, so a hypothesis moves to a neighbour by addition, and a pixel to another view by a homography.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64

from dynamictree.parallel import compiled, in_bands

_PATCH_REACH, _PATCH_STEP = 4, 2  # [px]: 25 samples in a square of 9
_PATCH_SIDE = 2 * _PATCH_REACH // _PATCH_STEP + 1
_TRIALS = 8  # number per pixel and sweep: four neighbours, four random changes
_FLAT = np.float32(1e-5)  # variance of grey below which matching is impossible
_HALF = np.float32(0.5)
_GREY_FALLOFF = 0.08  # difference from the centre that lowers a sample's weight by e: patches do not cross edges
_REPROJECTION_PX, _DEPTH_SHARE = 1.5, 0.012  # largest errors of agreeing views


class StereoView(NamedTuple):
    """Grey picture, with the transforms between its pixels and the world."""

    grey: Float32[np.ndarray, "H W"]
    to_pixel: Float64[np.ndarray, "3 4"]  # matrix from the world to pixel times depth
    to_ray: Float64[np.ndarray, "3 3"]  # matrix from a pixel to its ray in the world, at depth 1
    position: Float64[np.ndarray, "3"]

    def places(self, pixels: Float64[np.ndarray, "P 2"], depth: Float[np.ndarray, " P"]) -> Float64[np.ndarray, "P 3"]:
        """Back-project pixels to the world by their depth."""
        rays = pixels @ self.to_ray[:, :2].T + self.to_ray[:, 2]
        places: Float64[np.ndarray, "P 3"] = self.position + depth[:, None] * rays
        return places

    def pixels(
        self, places: Float64[np.ndarray, "P 3"]
    ) -> tuple[Float64[np.ndarray, "P 2"], Float64[np.ndarray, " P"]]:
        """Project points of the world to pixels and depths; pixels of points behind the camera are NaN."""
        across, down, depth = self.to_pixel[:, :3] @ places.T + self.to_pixel[:, 3:]
        before = np.where(depth > 0, depth, np.nan)
        return np.stack([across / before, down / before], axis=1), depth


class Hypotheses(NamedTuple):
    """Plane hypothesis of each pixel."""

    inverse: Float32[np.ndarray, "H W"]  # 1 / depth
    slope: Float32[np.ndarray, "H W 2"]  # change of 1 / depth to the right and down
    cost: Float32[np.ndarray, "H W"]  # 1 − correlation; 2 without any match


class _Matching(NamedTuple):
    """Inputs of the sweeps over one view."""

    grey: Float32[np.ndarray, "H W"]
    greys: Float32[np.ndarray, "S h w"]  # pictures of the neighbours, padded to one size
    sizes: Int32[np.ndarray, "S 2"]
    turn: Float32[np.ndarray, "S 3 3"]  # pixel (x, y) of inverse depth ρ maps to turn (x, y, 1) + shift ρ
    shift: Float32[np.ndarray, "S 3"]
    limits: Float32[np.ndarray, "3"]  # least and most inverse depth, steepest slope over inverse depth


def match_view(
    views: list[StereoView],
    first_guess: Hypotheses,
    bounds: tuple[float, float],
    mask: Bool[np.ndarray, "H W"],
    *,
    num_iterations: int = 4,
    seed: int = 0,
) -> Hypotheses:
    """Find the planes that maximise the correlation of the first view with the others, where the mask is set.

    `bounds` are the least and the greatest depth of surfaces [units of the cameras].
    """
    reference, *neighbours = views
    steepest = 3.0  # tangent of the angle between a surface and the picture
    greys = np.zeros((len(neighbours), *np.max([view.grey.shape for view in neighbours], axis=0)), np.float32)
    for row, view in enumerate(neighbours):
        greys[row, : view.grey.shape[0], : view.grey.shape[1]] = view.grey
    focal_px = 1 / np.linalg.norm(reference.to_ray[:, 0])
    limits = [1 / bounds[1], 1 / bounds[0], steepest / focal_px]
    matching = _Matching(
        grey=reference.grey,
        greys=greys,
        sizes=np.array([view.grey.shape for view in neighbours], np.int32),
        turn=np.array([view.to_pixel[:, :3] @ reference.to_ray for view in neighbours], np.float32),
        shift=np.array([view.to_pixel @ np.append(reference.position, 1) for view in neighbours], np.float32),
        limits=np.array(limits, np.float32),
    )
    hypotheses = Hypotheses(
        np.clip(first_guess.inverse, matching.limits[0], matching.limits[1]),
        first_guess.slope.copy(),
        np.full(mask.shape, 3, np.float32),
    )
    for sweep in range(2 * num_iterations):
        in_bands(_sweep_rows, len(mask), matching, mask, sweep, seed, hypotheses)
    return hypotheses


def neighbours_of(
    positions: Float64[np.ndarray, "V 3"], points: Float64[np.ndarray, "P 3"], seen: Int64[np.ndarray, "M 2"]
) -> list[list[int]]:
    """List, for each view, the others that see the same points at a good angle, best first."""
    angles_deg = (4.0, 12.0, 35.0)  # angle between rays to a point: least, best, most
    num_neighbours = 4
    visible = np.zeros((len(positions), len(points)), bool)
    visible[seen[:, 0], seen[:, 1]] = True
    rays = points[None] - positions[:, None]  # [V, P, 3]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    low, best, high = np.radians(angles_deg)
    chosen = []
    for view in range(len(positions)):
        both = visible & visible[view]
        angle = np.arccos(np.clip(np.einsum("vpc,pc->vp", rays, rays[view]), -1, 1))
        good = np.where(angle < best, (angle - low) / (best - low), (high - angle) / (high - best)).clip(0.02, 1)
        score = (good * both).sum(axis=1)
        score[view] = 0
        order = np.argsort(-score, kind="stable")
        chosen.append([int(other) for other in order[:num_neighbours] if score[other] > 0])
    return chosen


def agreed_depths(
    views: list[StereoView], hypotheses: list[Hypotheses], neighbours: list[list[int]], *, min_agreeing: int
) -> list[Float32[np.ndarray, "H W"]]:
    """Return depth maps [units of the cameras] with the depths that enough neighbours confirm; 0 elsewhere."""
    max_cost = 0.55  # 1 − correlation
    depths = []
    for view, others in enumerate(neighbours):
        own = hypotheses[view].inverse
        votes = sum((_agree(own, views[view], hypotheses[o].inverse, views[o]) for o in others), np.zeros(own.shape))
        sure = (votes >= min_agreeing) & (hypotheses[view].cost < max_cost)
        depths.append(np.where(sure, 1 / hypotheses[view].inverse, 0).astype(np.float32))
    return depths


def _agree(
    inverse: Float32[np.ndarray, "H W"], view: StereoView, other: Float32[np.ndarray, "h w"], other_view: StereoView
) -> Bool[np.ndarray, "H W"]:
    """Whether the other view's depth, projected back, gives the same pixel at the same depth."""
    row, column = np.indices(inverse.shape).reshape(2, -1) + 0.5
    pixels, depth = np.stack([column, row], axis=1), 1 / inverse.ravel().astype(np.float64)
    seen, _ = other_view.pixels(view.places(pixels, depth))
    inside = np.all((seen >= 0) & (seen < other.shape[::-1]), axis=1)  # false for NaN
    column, row = np.where(inside[:, None], seen, 0).astype(np.int64).T
    back, back_depth = view.pixels(other_view.places(seen, 1 / other[row, column].astype(np.float64)))
    near = ((back - pixels) ** 2).sum(axis=1) < _REPROJECTION_PX**2
    agree: Bool[np.ndarray, " P"] = inside & near & (np.abs(back_depth - depth) < _DEPTH_SHARE * depth)
    return agree.reshape(inverse.shape)


@compiled
@no_type_check
def _hash_random(x, y, number):
    """Return a pseudo-random number in [0, 1), a hash of the pixel and a counter."""
    bits = np.uint32(x) * np.uint32(0x9E3779B1) ^ np.uint32(y) * np.uint32(0x85EBCA77)
    bits ^= np.uint32(number) * np.uint32(0xC2B2AE3D)
    bits = (bits ^ (bits >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
    bits = (bits ^ (bits >> np.uint32(12))) * np.uint32(0x297A2D39)
    bits = bits ^ (bits >> np.uint32(15))
    return np.float32(bits & np.uint32(0xFFFFFF)) / np.float32(0x1000000)


@compiled
@no_type_check
def _sweep_rows(first, end, matching, mask, sweep, seed, hypotheses):
    """Propagate hypotheses to every second pixel from its neighbours, then try random changes."""
    grey = matching.grey
    height, width = grey.shape
    least, most, steepest = matching.limits[0], matching.limits[1], matching.limits[2]
    samples = _PATCH_SIDE * _PATCH_SIDE
    values, weight = np.empty(samples, np.float32), np.empty(samples, np.float32)
    costs = np.empty(len(matching.greys), np.float32)
    spread = np.float32(0.5) ** np.float32(sweep // 2)
    reach = 1 if sweep % 4 < 2 else 5
    for y in range(first, end):
        for x in range((y + sweep) % 2, width, 2):
            if not mask[y, x]:
                continue
            mean, variance = _reference_patch(grey, x, y, values, weight)
            if variance < _FLAT:
                hypotheses.cost[y, x] = 1
                continue
            patch = (values, weight, mean, variance)
            inverse, right, down = hypotheses.inverse[y, x], hypotheses.slope[y, x, 0], hypotheses.slope[y, x, 1]
            best = hypotheses.cost[y, x]
            if best > 2:
                best = _cost((x, y), (inverse, right, down), matching, patch, costs)
            for trial in range(_TRIALS):
                new_inverse, new_right, new_down = inverse, right, down
                if trial < 4:
                    dx = reach * (1 if trial == 0 else -1 if trial == 1 else 0)
                    dy = reach * (1 if trial == 2 else -1 if trial == 3 else 0)
                    if not (0 <= x + dx < width and 0 <= y + dy < height):
                        continue
                    new_right, new_down = hypotheses.slope[y + dy, x + dx, 0], hypotheses.slope[y + dy, x + dx, 1]
                    new_inverse = (
                        hypotheses.inverse[y + dy, x + dx] - np.float32(dx) * new_right - np.float32(dy) * new_down
                    )
                else:
                    number = (seed * 64 + sweep) * 64 + trial * 4
                    wide = np.float32(0.3) if trial == 4 and sweep < 4 else spread * np.float32(0.08)
                    new_inverse += wide * (most - least) * (_hash_random(x, y, number) - _HALF)
                    if trial != 5:
                        tilt = np.float32(2) * steepest * inverse * spread
                        new_right += tilt * (_hash_random(x, y, number + 1) - _HALF)
                        new_down += tilt * (_hash_random(x, y, number + 2) - _HALF)
                limit = steepest * new_inverse
                if not least <= new_inverse <= most or abs(new_right) > limit or abs(new_down) > limit:
                    continue
                cost = _cost((x, y), (new_inverse, new_right, new_down), matching, patch, costs)
                if cost < best:
                    best, inverse, right, down = cost, new_inverse, new_right, new_down
            hypotheses.cost[y, x], hypotheses.inverse[y, x] = best, inverse
            hypotheses.slope[y, x, 0], hypotheses.slope[y, x, 1] = right, down


@compiled
@no_type_check
def _reference_patch(grey, x, y, values, weight):
    """Sample a patch; weight samples by similarity to the centre; return weighted mean and variance."""
    height, width = grey.shape
    centre = grey[y, x]
    number = 0
    total, mean, square = np.float32(0), np.float32(0), np.float32(0)
    for dy in range(-_PATCH_REACH, _PATCH_REACH + 1, _PATCH_STEP):
        for dx in range(-_PATCH_REACH, _PATCH_REACH + 1, _PATCH_STEP):
            value = grey[min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)]
            near = np.exp(-abs(value - centre) * np.float32(1 / _GREY_FALLOFF))
            values[number], weight[number] = value, near
            total += near
            mean += near * value
            square += near * value * value
            number += 1
    mean /= total
    for index in range(number):
        weight[index] /= total
    return mean, square / total - mean * mean


@compiled
@no_type_check
def _cost(at, plane, matching, patch, costs):
    """Compute 1 − weighted correlation, averaged over the better half of the neighbours."""
    number = len(costs)
    for view in range(number):
        costs[view] = _cost_in_view(view, at, plane, matching, patch)
    keep = (number + 1) // 2
    total = np.float32(0)
    for _ in range(keep):
        least = 0
        for view in range(1, number):
            if costs[view] < costs[least]:
                least = view
        total += costs[least]
        costs[least] = 9.0
    return total / np.float32(keep)


@compiled
@no_type_check
def _cost_in_view(view, at, plane, matching, patch):
    x, y = at
    inverse, right, down = plane
    value_of, weight, mean, variance = patch
    grey, size, turn, shift = matching.greys[view], matching.sizes[view], matching.turn[view], matching.shift[view]
    # homogeneous pixel at the patch's first sample, and its change per sample
    px, py = np.float32(x) + _HALF - np.float32(_PATCH_REACH), np.float32(y) + _HALF - np.float32(_PATCH_REACH)
    start = inverse - np.float32(_PATCH_REACH) * (right + down)
    u0 = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] + shift[0] * start
    v0 = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] + shift[1] * start
    w0 = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] + shift[2] * start
    step = np.float32(_PATCH_STEP)
    ux, uy = step * (turn[0, 0] + shift[0] * right), step * (turn[0, 1] + shift[0] * down)
    vx, vy = step * (turn[1, 0] + shift[1] * right), step * (turn[1, 1] + shift[1] * down)
    wx, wy = step * (turn[2, 0] + shift[2] * right), step * (turn[2, 1] + shift[2] * down)
    for corner in range(4):  # if the corners are inside, all samples are
        i, j = np.float32(corner % 2 * (_PATCH_SIDE - 1)), np.float32(corner // 2 * (_PATCH_SIDE - 1))
        w = w0 + i * wx + j * wy
        if w <= 0:
            return np.float32(2)
        u, v = (u0 + i * ux + j * uy) / w - _HALF, (v0 + i * vx + j * vy) / w - _HALF
        if u < 0 or v < 0 or u >= size[1] - 1 or v >= size[0] - 1:
            return np.float32(2)
    number = 0
    total, square, product = np.float32(0), np.float32(0), np.float32(0)
    for j in range(_PATCH_SIDE):
        u, v, w = u0 + np.float32(j) * uy, v0 + np.float32(j) * vy, w0 + np.float32(j) * wy
        for _ in range(_PATCH_SIDE):
            scale = np.float32(1) / w
            column, row = u * scale - _HALF, v * scale - _HALF
            left, top = max(int(column), 0), max(int(row), 0)
            fx, fy = column - np.float32(left), row - np.float32(top)
            above = grey[top, left] + fx * (grey[top, left + 1] - grey[top, left])
            below = grey[top + 1, left] + fx * (grey[top + 1, left + 1] - grey[top + 1, left])
            value = above + fy * (below - above)
            share = weight[number] * value
            total += share
            square += share * value
            product += share * value_of[number]
            number += 1
            u, v, w = u + ux, v + vx, w + wx
    other_variance = square - total * total
    if other_variance < _FLAT:
        return np.float32(1)
    return np.float32(1) - (product - total * mean) / np.sqrt(variance * other_variance)
