// Wind that never repeats: the answer of /v1/spectra/{id}/wind, evaluated at any time as docs/engines.md says.

import { bandGains } from "./bands.js";

/** A bounded random function of time. */
const waveAt = ({ mean, limit, frequency_hz: hz, amplitude, phase_rad: phase }, t) =>
  mean +
  limit * Math.tanh(hz.reduce((sum, f, m) => sum + amplitude[m] * Math.cos(2 * Math.PI * f * t + phase[m]), 0) / limit);

/** The motion at `t` seconds, see `swingBones`, in a mean wind of `speed` [m/s]; the air is as fast as the gusts say. */
export function turbulentMotion(wind, t, { speed, gains = bandGains(wind.bands, speed), turn = 0 }) {
  const q = new Float32Array(2 * wind.frequencies_hz.length);
  q[0] = gains[0] * waveAt(wind.lean, t);
  const gust = waveAt(wind.strength, t);
  const strength = gust / Math.sqrt(wind.partial_hz[0].length);
  wind.partial_hz.forEach((hz, row) => {
    hz.forEach((f, j) => {
      const angle = 2 * Math.PI * f * t + wind.partial_phase_rad[row][j];
      q[2 * row + 2] += gains[row + 1] * strength * Math.cos(angle);
      q[2 * row + 3] += gains[row + 1] * strength * Math.sin(angle);
    });
  });
  const air = { speeds: [speed * Math.max(gust, 0) ** (1 / 1.4)], phase: t * wind.frequencies_hz[1] };
  return { q, turn: turn + waveAt(wind.turn_rad, t), air };
}
