"""Stems that grow level by level: splits, curvature, tropism, taper. Weber and Penn 1995, sections 4.1 to 4.8."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32

from lab.dataset.species import Level, Shape, Species

MIN_RADIUS_M = 0.002  # radius of tips and of the thinnest twig; scans do not show thinner tubes
CLEARANCE = 0.02  # share of the tree's height; branches stay above the ground by it
CHILD_TO_PARENT_RADIUS = 0.8  # largest ratio, so that a child's first ring stays inside its parent's tube


@dataclass(frozen=True, kw_only=True)
class Stems:
    """All stems of one branching level: one row per stem, R segments between P = R + 1 rings.

    A stem that splits off another stem of its level shares that stem's rings before `first`.
    """

    points: Float32[np.ndarray, "M P 3"]  # ring centres [m]
    radii: Float32[np.ndarray, "M P"]  # [m]
    first: Int32[np.ndarray, " M"]  # the stem's first own ring
    parent: Int32[np.ndarray, " M"]  # row one level up, or of this level if first > 0; -1 is the ground
    parent_ring: Float32[np.ndarray, " M"]  # position on the parent [rings]
    length_m: Float32[np.ndarray, " M"]  # length of the stem's own part
    sides: int

    @property
    def segments(self) -> int:
        """Return the number of segments, R."""
        return len(self.radii[0]) - 1


def shape_ratio(shape: Shape, place: Float32[np.ndarray, " M"]) -> Float32[np.ndarray, " M"]:
    """Return the relative length of a branch; `place` is 1 at the crown's base and 0 at its top. Weber-Penn table."""
    flame = np.where(place <= 0.7, place / 0.7, (1 - place) / 0.3)
    ratio = {
        "conical": 0.05 + 0.95 * place,
        "spherical": 0.2 + 0.8 * np.sin(np.pi * place),
        "hemispherical": 0.2 + 0.8 * np.sin(np.pi / 2 * place),
        "cylindrical": np.ones_like(place),
        "tapered-cylindrical": 0.5 + 0.5 * place,
        "flame": 0.05 + 0.95 * flame,
        "inverse-conical": 1 - 0.8 * place,
        "tend-flame": 0.5 + 0.5 * flame,
        "shallow-cone": 1 - 0.5 * place,
    }[shape]
    return ratio.astype(np.float32)


def rotate(
    vectors: Float[np.ndarray, "M 3"], axes: Float[np.ndarray, "M 3"], angles: Float[np.ndarray, " M"]
) -> Float32[np.ndarray, "M 3"]:
    """Rotate vectors about unit axes by angles [rad] (Rodrigues' formula)."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    along = (vectors * axes).sum(axis=1, keepdims=True) * axes
    moved: Float32[np.ndarray, "M 3"] = vectors * cosine + np.cross(axes, vectors) * sine + along * (1 - cosine)
    return moved.astype(np.float32)


def normalised(vectors: Float[np.ndarray, "... 3"]) -> Float32[np.ndarray, "... 3"]:
    """Scale vectors to length 1."""
    length = np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
    shortened: Float32[np.ndarray, ...] = vectors / length
    return shortened.astype(np.float32)


def perpendicular(directions: Float[np.ndarray, "M 3"]) -> Float32[np.ndarray, "M 3"]:
    """Return a unit vector perpendicular to each direction, horizontal where possible."""
    steep = np.abs(directions[:, 2:]) > 0.999
    reference = np.where(steep, np.array([[1, 0, 0]], np.float32), np.array([[0, 0, 1]], np.float32))
    return normalised(np.cross(reference, directions))


def grow_trunks(species: Species, rng: np.random.Generator) -> Stems:
    """Grow the stems of level 0 from the ground, z = 0."""
    level = species.levels[0]
    count = max(1, round(level.count)) if level.count > 1.5 else 1
    height = species.height_m[0]
    azimuth = np.arange(count) * np.deg2rad(137.5) + rng.uniform(0, 2 * np.pi)
    away = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1).astype(np.float32)
    lean = np.deg2rad(level.down * rng.uniform(0.2, 1, count) if count > 1 else rng.normal(0, 1.5, count))
    up = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    directions = rotate(up, normalised(np.cross(up, away)), lean.astype(np.float32))
    lengths = height * level.length * (1 + level.length_var * rng.uniform(-1, 1, count) * (count > 1))
    radii = lengths * species.ratio
    spread = 0.0 if count == 1 else 2.2 * radii.max()
    return _grow(
        level,
        base=(away * spread * rng.uniform(0.3, 1, (count, 1))).astype(np.float32),
        direction=directions,
        length=lengths.astype(np.float32),
        radius=radii.astype(np.float32),
        place=(np.full(count, -1, np.int32), np.zeros(count, np.float32)),
        rng=rng,
        flare=species.flare,
        base_splits=(species.base_splits, species.base_size),
    )


def grow_children(species: Species, depth: int, parents: Stems, rng: np.random.Generator) -> Stems:
    """Grow the stems of level `depth` on those of the previous level."""
    level = species.levels[depth]
    row, ring = _child_positions(species, depth, parents, rng)
    segment = np.minimum(ring.astype(np.int32), parents.segments - 1)
    share = (ring - segment)[:, None]
    low, high = parents.points[row, segment], parents.points[row, segment + 1]
    along = normalised(high - low)
    parent_radius = parents.radii[row, segment] * (1 - share[:, 0]) + parents.radii[row, segment + 1] * share[:, 0]

    relative = ring / parents.segments  # 0 at the parent's base, 1 at its tip
    whole = (parents.length_m * parents.segments / (parents.segments - parents.first))[row].astype(np.float32)
    length = _child_length(species, depth, relative, whole, rng)
    down = _down_angle(species, depth, relative, rng)
    start = np.concatenate([[True], row[1:] != row[:-1]])
    within = np.arange(len(row)) - np.maximum.accumulate(np.where(start, np.arange(len(row)), 0))
    phase = rng.uniform(0, 360, int(row.max(initial=0)) + 1)[row]
    azimuth = np.deg2rad(phase + within * level.rotate + rng.uniform(-1, 1, len(row)) * level.rotate_var)
    side = rotate(perpendicular(along), along, azimuth.astype(np.float32))
    direction = rotate(along, normalised(np.cross(along, side)), np.deg2rad(down).astype(np.float32))

    thick = parents.radii[row, parents.first[row]] * (length / parents.length_m[row]) ** species.ratio_power
    radius = np.clip(thick, MIN_RADIUS_M, np.maximum(CHILD_TO_PARENT_RADIUS * parent_radius, MIN_RADIUS_M))
    return _grow(
        level,
        base=((1 - share) * low + share * high).astype(np.float32),
        direction=normalised(direction),
        length=length,
        radius=radius.astype(np.float32),
        place=(row, ring),
        rng=rng,
    )


def _child_positions(
    species: Species, depth: int, parents: Stems, rng: np.random.Generator
) -> tuple[Int32[np.ndarray, " M"], Float32[np.ndarray, " M"]]:
    """Return each child's parent, and its position there in rings; evenly spread, in ascending order."""
    count = species.levels[depth].count
    lowest = species.base_size if depth == 1 else 0.15
    own = 1 - np.maximum(parents.first / parents.segments, lowest)  # share of the stem that can bear children
    wanted = count * own / (1 - lowest)
    if depth == 1:  # forks of the trunk share its branches
        wanted = wanted / np.sqrt(len(wanted))
    else:  # shorter stems bear fewer
        wanted = wanted * np.clip(0.25 + 0.75 * parents.length_m / np.percentile(parents.length_m, 80), 0, 1.3)
    numbers = np.floor(wanted + rng.uniform(0, 1, len(wanted))).astype(np.int32)
    if numbers.sum() == 0:
        numbers[0] = 1
    row = np.repeat(np.arange(len(numbers), dtype=np.int32), numbers)
    within = np.arange(len(row)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
    step = (within + rng.uniform(0.2, 0.8, len(row))) / numbers[row]  # position along the bearing part, 0 to 1
    ring = (1 - own[row] * (1 - step)) * parents.segments
    return row, np.minimum(ring, parents.segments - 0.02).astype(np.float32)


def _child_length(
    species: Species,
    depth: int,
    relative: Float32[np.ndarray, " M"],
    whole: Float32[np.ndarray, " M"],
    rng: np.random.Generator,
) -> Float32[np.ndarray, " M"]:
    level = species.levels[depth]
    spread = 1 + level.length_var * rng.uniform(-1, 1, len(relative))
    if depth == 1:
        place = np.clip((1 - relative) / (1 - species.base_size), 0, 1).astype(np.float32)
        along = shape_ratio(species.shape, place)
    else:
        along = 1 - 0.6 * relative
    return np.asarray(whole * level.length * along * spread, np.float32)


def _down_angle(
    species: Species, depth: int, relative: Float32[np.ndarray, " M"], rng: np.random.Generator
) -> Float32[np.ndarray, " M"]:
    level = species.levels[depth]
    if level.down_var >= 0:
        return (level.down + level.down_var * rng.uniform(-1, 1, len(relative))).astype(np.float32)
    lowest = species.base_size if depth == 1 else 0.0
    up = np.clip((relative - lowest) / (1 - lowest), 0, 1)  # a conifer's upper branches rise, its lower ones hang
    return (level.down + level.down_var * (2 * up - 1) + rng.uniform(-5, 5, len(relative))).astype(np.float32)


def _grow(
    level: Level,
    *,
    base: Float32[np.ndarray, "M 3"],
    direction: Float32[np.ndarray, "M 3"],
    length: Float32[np.ndarray, " M"],
    radius: Float32[np.ndarray, " M"],
    place: tuple[Int32[np.ndarray, " M"], Float32[np.ndarray, " M"]],
    rng: np.random.Generator,
    flare: float = 0.0,
    base_splits: tuple[float, float] = (0.0, 0.0),
) -> Stems:
    """Grow all stems ring by ring; a split adds a row that continues from the ring of the split."""
    segments = level.segments
    height_m = float(base[:, 2].max() + length.max())
    points = np.zeros((len(base), segments + 1, 3), np.float32)
    points[:, 0] = base
    first = np.zeros(len(base), np.int32)
    parent, parent_ring = place
    step = length / segments
    fork_ring = max(1, round(base_splits[1] * segments))
    for ring in range(segments):
        if ring:
            expected = level.splits + (base_splits[0] / len(base) if ring == fork_ring else 0.0)
            drawn = np.floor(expected + rng.uniform(0, 1, len(points))).astype(np.int32)  # whose mean is `expected`
            clones = np.repeat(np.arange(len(points)), drawn)
            if len(clones):
                direction, forked = _spread_clones(direction, clones, level.split_angle, rng)
                direction = np.concatenate([direction, forked])
                points = np.concatenate([points, points[clones]])
                step = np.concatenate([step, step[clones] * rng.uniform(0.8, 1, len(clones))]).astype(np.float32)
                radius = np.concatenate([radius, radius[clones]])
                first = np.concatenate([first, np.full(len(clones), ring, np.int32)])
                parent = np.concatenate([parent, clones.astype(np.int32)])
                parent_ring = np.concatenate([parent_ring, np.full(len(clones), ring, np.float32)])
        points[:, ring + 1] = points[:, ring] + direction * step[:, None]
        points[:, ring + 1, 2] = np.maximum(points[:, ring + 1, 2], CLEARANCE * (1 + ring) / segments * height_m)
        direction = _bend(level, direction, ring, rng)
    height = np.linspace(0, 1, segments + 1, dtype=np.float32)
    profile = (1 - level.taper * height) * (1 + flare * np.maximum(100 ** (1 - 8 * height) - 1, 0) / 99)
    radii = np.maximum(radius[:, None] * profile, MIN_RADIUS_M)
    own = step * (segments - first)
    return Stems(
        points=points,
        radii=radii.astype(np.float32),
        first=first,
        parent=parent,
        parent_ring=parent_ring,
        length_m=own.astype(np.float32),
        sides=level.sides,
    )


def _spread_clones(
    direction: Float32[np.ndarray, "M 3"],
    clones: Int32[np.ndarray, " C"] | np.ndarray,
    angle: float,
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "M 3"], Float32[np.ndarray, "C 3"]]:
    """Spread the source and its clones apart by `angle` degrees, to random sides."""
    numbers = np.bincount(clones, minlength=len(direction))
    side = rotate(perpendicular(direction), direction, rng.uniform(0, 2 * np.pi, len(direction)).astype(np.float32))
    half = np.deg2rad(angle) * rng.uniform(0.4, 0.6, len(direction))
    first_direction = rotate(direction, side, (-half * (numbers > 0)).astype(np.float32))
    order = np.arange(len(clones)) - np.searchsorted(clones, clones)
    turn = (2 * np.pi * (order + 1) / (numbers[clones] + 1)).astype(np.float32)
    clone_side = rotate(side[clones], direction[clones], turn)
    return first_direction, rotate(direction[clones], clone_side, (-half[clones]).astype(np.float32))


def _bend(
    level: Level, direction: Float32[np.ndarray, "M 3"], ring: int, rng: np.random.Generator
) -> Float32[np.ndarray, "M 3"]:
    """Bend directions by one segment's share of curvature, random deviation and tropism."""
    total = level.curve if level.curve_back is None or ring < level.segments / 2 else level.curve_back
    count = len(direction)
    level_axis = perpendicular(direction)
    direction = rotate(direction, level_axis, np.full(count, np.deg2rad(total / level.segments), np.float32))
    wander = rotate(perpendicular(direction), direction, rng.uniform(0, 2 * np.pi, count).astype(np.float32))
    size = np.deg2rad(level.curve_var) / level.segments * rng.normal(0, 1, count)
    direction = rotate(direction, wander, size.astype(np.float32))
    if level.tropism:
        declination = np.arccos(np.clip(direction[:, 2], -1, 1))
        if level.tropism > 0:
            angle = np.minimum(level.tropism * declination / level.segments, declination)
        else:
            angle = np.maximum(level.tropism * (np.pi - declination) / level.segments, declination - np.pi)
        direction = rotate(direction, perpendicular(direction), (-angle).astype(np.float32))
    return normalised(direction)
