// Vectors [x, y, z] as arrays.

export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.sqrt(dot(a, a));
export const rowOf = (values, i) => [values[3 * i], values[3 * i + 1], values[3 * i + 2]];

/** Row of the nearest of points [3N], among those that `isOne(row)`; null where there is none. */
export function nearest(points, to, isOne = (_row) => true) {
  const [x, y, z] = to;
  let [best, least] = [null, Infinity];
  for (let i = 0; i < points.length / 3; i++) {
    const distance = (points[3 * i] - x) ** 2 + (points[3 * i + 1] - y) ** 2 + (points[3 * i + 2] - z) ** 2;
    if (distance < least && isOne(i)) [best, least] = [i, distance];
  }
  return best;
}

/** About the vertical axis. */
export function turnedUpright(v, angle) {
  const [x, y, z] = v;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return [c * x - s * y, s * x + c * y, z];
}
