// How much stronger each mode is in another wind: `wind_bands` of a spectrum, or a power law.

/** Nearest to the shipped model's answer: speed^1.4 up to 12 m/s; above, where crowns streamline, in proportion to speed. */
export const drag = (speed) => speed * Math.min(Math.max(speed, 0), 12) ** 0.4;

/** Bands of a motion that no other wind was asked for, up to 30 m/s. */
export function powerLaw(K, reference) {
  const own = Math.max(reference, 0.1);
  const speeds_m_s = [0, own, Math.max(30, own + 1)];
  return { speeds_m_s, gains: speeds_m_s.map((speed) => Array(K).fill(drag(speed) / drag(own))) };
}

/** Gain of each bin at a mean speed [m/s]: linear in the drag between two bands, constant above the last. */
export function bandGains({ speeds_m_s: speeds, gains }, speed) {
  const above = speeds.findIndex((one) => speed < one);
  if (above < 0) return gains.at(-1);
  if (above === 0) return gains[0];
  const [low, high] = [drag(speeds[above - 1]), drag(speeds[above])];
  const share = (drag(speed) - low) / (high - low);
  return gains[above].map((gain, k) => gains[above - 1][k] + share * (gain - gains[above - 1][k]));
}
