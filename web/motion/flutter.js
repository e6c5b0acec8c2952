// Leaves flutter where the air is faster than a critical speed: fast tones of the bones that carry no other. docs/engines.md.

import { plus, rowOf, scaled } from "./vectors.js";

const [FLAP_RAD, TWIST_RAD] = [0.22, 0.35]; // standard deviations in a strong wind
// Speeds above the mean, over their standard deviation: the upper half of sixteen that are equally frequent.
const GUSTS = [0.078412, 0.237202, 0.40225, 0.579132, 0.776422, 1.00999, 1.318011, 1.862732];

/** Air at a phase of the loop; `speeds` [m/s] are equally frequent. */
export const gustyAir = ({ speed_m_s, gust = 0.3 }, phase) => ({
  speeds: GUSTS.flatMap((g) => [1 + gust * g, 1 - gust * g]).map((share) => speed_m_s * Math.max(share, 0)),
  phase,
});

/** A bone's turn beside the one of the modes [rad]; none of a surface from before version 3. */
export function flutterOf(surface, b, { speeds, phase }) {
  const { flutter_tones: tones, flutter_critical_m_s: critical, flutter_share: shares } = surface;
  if (!shares?.[b]) return [0, 0, 0];
  let onsets = 0;
  for (const speed of speeds) {
    const over = Math.max(speed / critical[b] - 1, 0) ** 2;
    onsets += (over / (1 + over)) ** 2;
  }
  const size = shares[b] * Math.sqrt(onsets / (2 * speeds.length));
  if (!size) return [0, 0, 0];
  const wave = (at, row) => tones[at] && Math.cos(2 * Math.PI * (tones[at] * phase + tones[at + row] / 256));
  const [flap, twist] = [1, 2].map((row) => [0, 3, 6, 9].reduce((sum, tone) => sum + wave(12 * b + tone, row), 0));
  const across = scaled(rowOf(surface.flutter_axis, b), size * FLAP_RAD * flap);
  return plus(across, scaled(rowOf(surface.turn_direction, b), size * TWIST_RAD * twist));
}
