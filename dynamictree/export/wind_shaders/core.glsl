float wave(int first, float mean, float limit, float t) {
  GUSTS_TABLE
  float sum = 0.0;
  for (int m = first; m < first + NUM_GUSTS; m++) sum += GUSTS[m].y * cos(6.2831853 * GUSTS[m].x * t + GUSTS[m].z);
  return mean + limit * tanh(sum / limit);
}
float gain(int k, float mean_speed) { // of bin k over its size at the speed the motion was made for
  DRAGS_TABLE GAINS_TABLE
  float sum = 0.0, drag = pow(max(mean_speed, 0.0), 1.4);
  for (int b = 1, row = k; b < NUM_BANDS; b++, row += NUM_BINS + 1)
    sum += (GAINS[row + NUM_BINS + 1] - GAINS[row]) * clamp((drag - DRAGS[b - 1]) / (DRAGS[b] - DRAGS[b - 1]), 0.0, 1.0);
  return sum;
}
vec3 wind(TEXTUREvec2 lookup, float t, float mean_speed) { // displacement [m] in glTF's axes, of the vertex with this TEXCOORD_1
  PARTIALS_TABLE
  float lean = gain(0, mean_speed) * wave(NUM_GUSTS, LEAN_MEAN, LEAN_LIMIT, t);
  vec3 moved = MODE(0) * lean, theta = TURN(0) * lean;
  float strength = wave(0, STRENGTH_MEAN, STRENGTH_LIMIT, t) / sqrt(float(NUM_PARTIALS));
  for (int k = 0; k < NUM_BINS; k++) {
    vec2 q = vec2(0.0, 0.0);
    for (int j = 0; j < NUM_PARTIALS; j++) {
      float angle = 6.2831853 * PARTIALS[NUM_PARTIALS * k + j].x * t + PARTIALS[NUM_PARTIALS * k + j].y;
      q += vec2(cos(angle), sin(angle));
    }
    q *= strength * gain(k + 1, mean_speed);
    moved += MODE(2 * k + 1) * q.x - MODE(2 * k + 2) * q.y;
    theta += TURN(2 * k + 1) * q.x - TURN(2 * k + 2) * q.y;
  }
  float turn = wave(2 * NUM_GUSTS, 0.0, TURN_LIMIT, t);
  moved = vec3(cos(turn) * moved.x + sin(turn) * moved.z, moved.y, cos(turn) * moved.z - sin(turn) * moved.x);
  theta = vec3(cos(turn) * theta.x + sin(turn) * theta.z, theta.y, cos(turn) * theta.z - sin(turn) * theta.x);
  vec3 arm = ARM; // from the pivot of this vertex' leaf card, which turns by atan |theta| and keeps its size
  float c = 1.0 / sqrt(1.0 + dot(theta, theta));
  return moved + (c - 1.0) * arm + c * cross(theta, arm) + c * c / (1.0 + c) * dot(theta, arm) * theta;
}
