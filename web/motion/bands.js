// How much stronger each mode is in another wind: `wind_bands` of a spectrum, or a power law.

/** The power nearest to the shipped model's answer: a crown yields, so it grows with U^1.4, not U² (Vogel). */
const DRAG_EXPONENT = 1.4;
const FASTEST_M_S = 30;

/** Bands of a motion that no other wind was asked for. */
export function powerLaw(K, reference) {
  const own = Math.max(reference, 0.1);
  const speeds_m_s = [0, own, Math.max(FASTEST_M_S, own + 1)];
  return { speeds_m_s, gains: speeds_m_s.map((speed) => Array(K).fill((speed / own) ** DRAG_EXPONENT)) };
}

/** Gain of each bin at a mean speed [m/s]: linear in speed^1.4 between two bands, constant above the last. */
export function bandGains({ speeds_m_s: speeds, gains }, speed) {
  const drag = (value) => Math.max(value, 0) ** DRAG_EXPONENT;
  const above = speeds.findIndex((one) => speed < one);
  if (above < 0) return gains.at(-1);
  if (above === 0) return gains[0];
  const [low, high] = [drag(speeds[above - 1]), drag(speeds[above])];
  const share = (drag(speed) - low) / (high - low);
  return gains[above].map((gain, k) => gains[above - 1][k] + share * (gain - gains[above - 1][k]));
}
