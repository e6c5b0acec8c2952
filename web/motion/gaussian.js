// One Gaussian that rides on its face, as numbers: what draw/splat_shader.js computes for all of them.

import { dot, frameOf, length, minus, plus, rowOf, scaled } from "./vectors.js";

/** Where the wind alone has the middle of a Gaussian of a ride (draw/ride.js) [m]. */
export function gaussianInWind(ride, gaussian, q, turn) {
  const rows = cornersOf(ride, gaussian);
  const weights = rowOf(ride.weights, gaussian);
  const rest = rows.map((row) => rowOf(ride.vertices, row));
  const now = rows.map((row, i) => plus(rest[i], ride.inWind(row, q, turn)));
  const foot = (corners) => corners.reduce((sum, at, i) => plus(sum, scaled(at, weights[i])), [0, 0, 0]);
  return plus(foot(now), turnedWithFace(rest, now, minus(rowOf(ride.means, gaussian), foot(rest))));
}

/** Bones that carry a Gaussian, and their weights: those of the corners of its face together. */
export function bonesOfGaussian(ride, gaussian) {
  const shares = new Map();
  cornersOf(ride, gaussian).forEach((row, corner) => {
    for (let i = 0; i < 4; i++) {
      const bone = ride.carriers[8 * row + i];
      const weight = ride.weights[3 * gaussian + corner] * ride.carriers[8 * row + 4 + i];
      if (weight > 0) shares.set(bone, (shares.get(bone) ?? 0) + weight);
    }
  });
  return { bones: [...shares.keys()], weights: [...shares.values()] };
}

const cornersOf = ({ face_of, triangles }, gaussian) => rowOf(triangles, face_of[gaussian]);

/** An arm that turns with its face: by the face's normal, and in its plane by the rotation nearest to how it deforms. */
function turnedWithFace(rest, now, arm) {
  const before = sidesOf(rest);
  const after = sidesOf(now);
  const along = after.edge / before.edge;
  const across = after.y / before.y;
  const slant = (after.x - along * before.x) / before.y;
  const size = Math.hypot(along + across, slant);
  const [c, s] = size > 1e-6 ? [(along + across) / size, -slant / size] : [1, 0];
  const [x, y, z] = before.frame.map((axis) => dot(axis, arm));
  return [c * x - s * y, s * x + c * y, z].reduce((sum, part, i) => plus(sum, scaled(after.frame[i], part)), [0, 0, 0]);
}

/** A face in its own plane: its frame, its first edge, and where its third corner lies. */
function sidesOf([a, b, c]) {
  const frame = frameOf(minus(b, a), minus(c, a));
  const third = minus(c, a);
  return { frame, edge: length(minus(b, a)), x: dot(third, frame[0]), y: dot(third, frame[1]) };
}
