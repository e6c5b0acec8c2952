float wave(int first, float mean, float limit, float t) {
  GUSTS_TABLE
  float sum = 0.0;
  for (int m = first; m < first + NUM_GUSTS; m++) sum += GUSTS[m].y * cos(6.2831853 * GUSTS[m].x * t + GUSTS[m].z);
  return mean + limit * tanh(sum / limit);
}
float gain(int k, float mean_speed) { // of bin k over its size at the speed the motion was made for
  DRAGS_TABLE GAINS_TABLE
  float sum = 0.0, drag = mean_speed * pow(clamp(mean_speed, 0.0, 12.0), 0.4); // speed^1.4, above 12 m/s linear
  for (int b = 1, row = k; b < NUM_BANDS; b++, row += NUM_BINS + 1)
    sum += (GAINS[row + NUM_BINS + 1] - GAINS[row]) * clamp((drag - DRAGS[b - 1]) / (DRAGS[b] - DRAGS[b - 1]), 0.0, 1.0);
  return sum;
}
vec2 coordinate(int k, float t, float mean_speed) { // of bin k = 1 to NUM_BINS, without the strength of the gusts
  PARTIALS_TABLE
  vec2 q = vec2(0.0, 0.0);
  for (int j = NUM_PARTIALS * (k - 1); j < NUM_PARTIALS * k; j++) {
    float angle = 6.2831853 * PARTIALS[j].x * t + PARTIALS[j].y;
    q += vec2(cos(angle), sin(angle));
  }
  return q * gain(k, mean_speed);
}
vec3 turned(vec3 turn, vec3 arm) { // a turn is its axis times the sine of half the angle
  return arm + 2.0 * cross(turn, cross(turn, arm) + sqrt(1.0 - dot(turn, turn)) * arm);
}
vec3 turn_of(TEXTUREvec2 bone, vec2 q[NUM_COORDINATES], vec2 direction, float t, float air_speed) {
  vec3 theta = BONE(bone, 0) * q[0].x, reach = BONE(bone, DIRECTION), onset = BONE(bone, ONSET);
  for (int k = 1; k <= NUM_BINS; k++) theta += BONE(bone, 2 * k - 1) * q[k].x - BONE(bone, 2 * k) * q[k].y;
  vec3 swing = cross(theta, reach); // of the bone's end; it follows the direction of the wind
  swing = vec3(direction.x * swing.x + direction.y * swing.z, swing.y, direction.x * swing.z - direction.y * swing.x);
  theta = cross(reach, swing) + dot(theta, reach) * reach;
  float over = max(air_speed / onset.x - 1.0, 0.0), size = onset.y * over * over / (1.0 + over * over);
  for (int j = TONES; j < ONSET && size > 0.0; j++) { // flutter of a leaf or twig end
    vec3 tone = BONE(bone, j), turn = size * min(tone.x, 1.0) * cos(6.2831853 * (tone.x * fract(t / PERIOD) + tone));
    theta += FLAP * turn.y * BONE(bone, AXIS) + TWIST * turn.z * reach;
  }
  float c = 1.0 / sqrt(1.0 + dot(theta, theta)); // cosine of the angle, which is atan |theta|
  return theta * c / sqrt(2.0 + 2.0 * c);
}
vec3 pose(TEXTUREvec2 texel, float t, float mean_speed) { // of bones: how far the foot moves [m], turn, foot, turn of the parent
  int part = int(4.0 * texel.y);
  vec2 bone = vec2(texel.x, fract(4.0 * texel.y)), parent = BONE(bone, PARENT).xy;
  vec3 foot = BONE(bone, FOOT), moved = vec3(0.0, 0.0, 0.0);
  if (part == 2) return foot;
  vec2 q[NUM_COORDINATES];
  q[0] = vec2(gain(0, mean_speed) * wave(NUM_GUSTS, LEAN_MEAN, LEAN_LIMIT, t), 0.0);
  float strength = wave(0, STRENGTH_MEAN, STRENGTH_LIMIT, t), air_speed = mean_speed * pow(max(strength, 0.0), DRAG_ROOT);
  for (int k = 1; k <= NUM_BINS; k++) q[k] = strength / sqrt(float(NUM_PARTIALS)) * coordinate(k, t, mean_speed);
  float angle = wave(2 * NUM_GUSTS, 0.0, TURN_LIMIT, t); vec2 direction = vec2(cos(angle), sin(angle));
  if (part == 1) return turn_of(TEXTURES bone, q, direction, t, air_speed);
  if (part == 3) return turn_of(TEXTURES parent, q, direction, t, air_speed);
  for (int i = 0; i < MOST_ANCESTORS && parent.x > 0.0; i++, parent = BONE(parent, PARENT).xy) {
    vec3 arm = foot - BONE(parent, FOOT);
    foot = BONE(parent, FOOT);
    moved += turned(turn_of(TEXTURES parent, q, direction, t, air_speed), arm) - arm;
  }
  return moved;
}
