"""Shade samples by Lambert's law under sun and sky, with ground and sky behind."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64, Int32

from dynamictree.parallel import compiled
from dynamictree.render.appearance import Appearance, albedo_at
from dynamictree.render.light import MAX_SHADOW_SAMPLES, SkyVolume, SunMap, sky_share, sun_share

# linear light; the sum is about 1 on a level white surface
_SUN = (1.28, 1.13, 0.90)
_SKY = (0.42, 0.47, 0.55)
_BOUNCE = (0.26, 0.24, 0.21)  # light from the ground on surfaces that face down
_GROUND = (0.46, 0.465, 0.45)
_HORIZON, _ZENITH = (0.80, 0.84, 0.88), (0.36, 0.53, 0.78)

# shadow samples per pixel and per sample of a pixel; integers of one type, so that one compilation serves both
_PIXEL_SHADOW_SAMPLES, _SUBSAMPLE_SHADOW_SAMPLES = np.int64(MAX_SHADOW_SAMPLES), np.int64(3)


class Scene(NamedTuple):
    """Mesh and light of a picture."""

    vertices: Float64[np.ndarray, "N 3"]
    normals: Float64[np.ndarray, "N 3"]
    faces: Int32[np.ndarray, "F 3"]
    appearance: Appearance
    sun_direction: Float64[np.ndarray, "3"]
    sun: SunMap
    sky: SkyVolume
    shadows: bool
    ground: bool
    centre: Float64[np.ndarray, "3"]  # centre of the mesh's footprint, on the ground [m]
    radius_m: float  # half the diagonal of the mesh's bounding box


class View(NamedTuple):
    """Camera for pictures of one size."""

    position: Float64[np.ndarray, "3"]
    ray: Float64[np.ndarray, "3 3"]  # matrix from (x, y, 1) in samples to a direction in the world
    supersampling: int


@compiled
@no_type_check
def shade_rows(first, end, picture, visible_face, triangles, scene, view):
    """Fill rows of the picture with the mean linear light of each pixel's samples.

    If all samples see the same face, the light is computed once, at the pixel's centre.
    """
    n, ray, position, sun, sky = view.supersampling, view.ray, view.position, scene.sun, scene.sky
    ground = scene.centre, scene.radius_m, scene.sun_direction[2], scene.shadows
    has_ground = scene.ground and view.position[2] > scene.centre[2]
    for row in range(first, end):
        for column in range(picture.shape[1]):
            top, left = row * n, column * n
            face = visible_face[top, left]
            alike = True
            for sample in range(1, n * n):
                alike = alike and visible_face[top + sample // n, left + sample % n] == face
            samples = 1 if alike else n * n
            red, green, blue = 0.0, 0.0, 0.0
            for sample in range(samples):
                i, j = top + sample // n, left + sample % n
                x, y = (left + 0.5 * n, top + 0.5 * n) if alike else (j + 0.5, i + 0.5)
                # neighbouring pixels use different shadow patterns, so that penumbras have noise instead of rings
                looks = row * 5 + column * 7 + sample, _PIXEL_SHADOW_SAMPLES if alike else _SUBSAMPLE_SHADOW_SAMPLES
                direction, face = _direction(ray, x, y), visible_face[i, j]
                if face >= 0:
                    r, g, b = _surface_light((x, y), face, triangles, direction, scene, looks)
                elif has_ground and direction[2] < 0:
                    r, g, b = _ground_light(position, direction, ground, sun, sky, looks)
                else:
                    r, g, b = _sky_light(direction[2])
                red, green, blue = red + r / samples, green + g / samples, blue + b / samples
            picture[row, column, 0], picture[row, column, 1], picture[row, column, 2] = red, green, blue


@compiled
@no_type_check
def _direction(ray, x, y):
    dx = ray[0, 0] * x + ray[0, 1] * y + ray[0, 2]
    dy = ray[1, 0] * x + ray[1, 1] * y + ray[1, 2]
    dz = ray[2, 0] * x + ray[2, 1] * y + ray[2, 2]
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx / length, dy / length, dz / length


@compiled
@no_type_check
def _sky_light(rise):
    share = 1 - np.exp(-4 * max(rise, 0.0))
    return (
        _HORIZON[0] + share * (_ZENITH[0] - _HORIZON[0]),
        _HORIZON[1] + share * (_ZENITH[1] - _HORIZON[1]),
        _HORIZON[2] + share * (_ZENITH[2] - _HORIZON[2]),
    )


@compiled
@no_type_check
def _ground_light(position, direction, ground, sun, sky, looks):
    dx, dy, dz = direction
    centre, radius_m, sun_rise, shadows = ground
    back, z = _sky_light(dz), centre[2]
    distance = (z - position[2]) / dz
    x, y = position[0] + distance * dx, position[1] + distance * dy
    away = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / radius_m
    haze = min(max((away - 1.5) / 7.5, 0.0), 1.0)
    haze = haze * haze * (3 - 2 * haze)
    lit, open_sky = 1.0, 1.0
    if shadows and haze < 1:
        lit = sun_share(sun, x, y, z, looks)
        open_sky = sky_share(sky, x, y, z)
    lit *= sun_rise
    return (
        back[0] * haze + (1 - haze) * _GROUND[0] * (_SUN[0] * lit + _SKY[0] * open_sky),
        back[1] * haze + (1 - haze) * _GROUND[1] * (_SUN[1] * lit + _SKY[1] * open_sky),
        back[2] * haze + (1 - haze) * _GROUND[2] * (_SUN[2] * lit + _SKY[2] * open_sky),
    )


@compiled
@no_type_check
def _blend(values, corners, weights):
    a, b, c = weights
    p, q, r = values[corners[0]], values[corners[1]], values[corners[2]]
    return a * p[0] + b * q[0] + c * r[0], a * p[1] + b * q[1] + c * r[1], a * p[2] + b * q[2] + c * r[2]


@compiled
@no_type_check
def _surface_normal(vertices, normals, corners, weights, direction):
    """Return the smooth normal, or the face's if they differ by more than 60 degrees, towards the viewer."""
    p, q, r = vertices[corners[0]], vertices[corners[1]], vertices[corners[2]]
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    face_length = np.sqrt(fx * fx + fy * fy + fz * fz) + 1e-300
    fx, fy, fz = fx / face_length, fy / face_length, fz / face_length
    nx, ny, nz = _blend(normals, corners, weights)
    length = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-300
    nx, ny, nz = nx / length, ny / length, nz / length
    if nx * fx + ny * fy + nz * fz < 0.5:
        nx, ny, nz = fx, fy, fz
    side = -1.0 if fx * direction[0] + fy * direction[1] + fz * direction[2] > 0 else 1.0
    return side * nx, side * ny, side * nz


@compiled
@no_type_check
def _surface_light(at, face, triangles, direction, scene, looks):
    x, y = at
    m, level, corners = triangles.barycentric[face], triangles.level[face], scene.faces[face]
    a, b, c = m[0] * x + m[1] * y + m[2], m[3] * x + m[4] * y + m[5], m[6] * x + m[7] * y + m[8]
    weights = (a / (a + b + c), b / (a + b + c), c / (a + b + c))
    material = scene.appearance.face_material[face]
    red, green, blue = albedo_at(scene.appearance, corners, material, level, weights)
    nx, ny, nz = _surface_normal(scene.vertices, scene.normals, corners, weights, direction)
    x, y, z = _blend(scene.vertices, corners, weights)
    facing = nx * scene.sun_direction[0] + ny * scene.sun_direction[1] + nz * scene.sun_direction[2]
    lit, open_sky = 1.0, 1.0
    if scene.shadows:
        offset = (2.0 if facing > 0 else -2.0) / scene.sun.texels_per_m
        lit = sun_share(scene.sun, x + offset * nx, y + offset * ny, z + offset * nz, looks)
        cell = scene.sky.cell_m
        open_sky = sky_share(scene.sky, x + cell * nx, y + cell * ny, z + cell * nz)
    direct = lit * (facing if facing > 0 else -facing * scene.appearance.transmission[material])
    dome = 0.5 + 0.5 * nz
    return (
        red * (_SUN[0] * direct + open_sky * (_SKY[0] * dome + _BOUNCE[0] * (1 - dome))),
        green * (_SUN[1] * direct + open_sky * (_SKY[1] * dome + _BOUNCE[1] * (1 - dome))),
        blue * (_SUN[2] * direct + open_sky * (_SKY[2] * dome + _BOUNCE[2] * (1 - dome))),
    )
