// Trees beside the one that is pulled: where they stand, and what the wind does to each. Numbers only.

import { gustyAir } from "./flutter.js";
import { windCoordinates } from "./modes.js";
import { turbulentMotion } from "./turbulence.js";

/** The other nine of a forest, in widths of the tree: +X is to the right and +Y away from the first view. */
const FOREST = [
  [-1.05, 0.5],
  [1.0, 0.35],
  [-0.45, 1.25],
  [0.6, 1.2],
  [-1.6, 1.5],
  [1.65, 1.35],
  [0.05, 2.15],
  [-1.1, 2.3],
  [1.2, 2.2],
];
const GOLDEN_RAD = Math.PI * (3 - Math.sqrt(5)); // no two look the same way
const BESIDE = 1.15; // widths between the two of a pair
const SLOWEST_M_S = 2; // that a gust travels: in calm all would else sway as by chance
const TURN_RAD = Math.atan2(-0.38, 1); // from +X to the right of the first view

/** Where copies stand, from the tree's foot [m], how each is turned [rad], and its size against the tree's. */
export const forestPlaces = (width) =>
  FOREST.map(([right, away], i) => ({
    ...turned(width * right, width * away),
    yaw: GOLDEN_RAD * (i + 1),
    size: 0.86 + 0.06 * ((i * 2) % 5),
  }));

/** The one beside it, to the right. */
export const pairPlaces = (width) => [{ ...turned(BESIDE * width, 0), yaw: 0, size: 1 }];

function turned(right, away) {
  const [c, s] = [Math.cos(TURN_RAD), Math.sin(TURN_RAD)];
  return { x: c * right - s * away, y: s * right + c * away };
}

/** How much later than at the tree's foot the wind is at a place [s]. */
export const delayAt = ({ x, y }, direction_rad, speed_m_s) =>
  (x * Math.cos(direction_rad) + y * Math.sin(direction_rad)) / Math.max(speed_m_s, SLOWEST_M_S);

/** The strength of the gust that crosses a forest once a loop; 1 in the mean. */
export const gustAt = (phase) => 0.625 + ((1 + Math.cos(2 * Math.PI * phase)) / 2) ** 2;

/**
 * The motion in a mean wind of `speed` [m/s], `delay` seconds late: of the loop, or of endless wind where `turbulent` is
 * its table; `gusty` with the forest's gust. `made` is the wind of the loop itself.
 */
export function windMotion({ K, phase, period, seconds, turbulent, made }, { speed, gains, turn, delay = 0, gusty }) {
  if (turbulent) return turbulentMotion(turbulent, seconds - delay, { speed, gains, turn });
  const then = phase - delay / period;
  const q = windCoordinates(K, then, gains, gusty ? gustAt(then) : 1);
  return { q, turn, air: gustyAir({ ...made, speed_m_s: speed }, then) };
}

/** `windMotion` of each copy in its own axes. */
export const forestMotions = (places, now, wind) =>
  places.map((place) => {
    const delay = delayAt(place, now.direction_rad, wind.speed);
    return windMotion(now, { ...wind, turn: wind.turn - place.yaw, delay, gusty: true });
  });
