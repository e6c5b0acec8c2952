// Wind that never repeats: the answer of /v1/spectra/{id}/wind, evaluated at any time as docs/engines.md says.

import { bandGains } from "./bands.js";

/** A bounded random function of time. */
const waveAt = ({ mean, limit, frequency_hz: hz, amplitude, phase_rad: phase }, t) =>
  mean +
  limit * Math.tanh(hz.reduce((sum, f, m) => sum + amplitude[m] * Math.cos(2 * Math.PI * f * t + phase[m]), 0) / limit);

/**
 * Coordinates of all bins, real and imaginary part, and the turn of the whole displacement [rad] at `t` seconds; `gains`
 * are those of `bandGains` for the mean speed now.
 */
export function turbulentCoordinates(wind, t, gains = bandGains(wind.bands, wind.wind.speed_m_s)) {
  const q = new Float32Array(2 * wind.frequencies_hz.length);
  q[0] = gains[0] * waveAt(wind.lean, t);
  const strength = waveAt(wind.strength, t) / Math.sqrt(wind.partial_hz[0].length);
  wind.partial_hz.forEach((hz, row) => {
    hz.forEach((f, j) => {
      const angle = 2 * Math.PI * f * t + wind.partial_phase_rad[row][j];
      q[2 * row + 2] += gains[row + 1] * strength * Math.cos(angle);
      q[2 * row + 3] += gains[row + 1] * strength * Math.sin(angle);
    });
  });
  return { q, turn: waveAt(wind.turn_rad, t) };
}
