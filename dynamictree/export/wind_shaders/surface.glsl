vec3 turned(vec3 turn, vec3 arm) { // a turn is its axis times the sine of half the angle
  return arm + 2.0 * cross(turn, cross(turn, arm) + sqrt(1.0 - dot(turn, turn)) * arm);
}
vec3 wind(TEXTUREvec2 lookup, vec3 place) { // displacement [m] in glTF's axes, of the vertex with this TEXCOORD_1
  float number = floor(lookup.x * NUM_BONES), row = floor(number / WIDTH);
  vec2 bone = vec2((number - row * WIDTH + 0.5) / WIDTH, (row + 0.5) / ROWS);
  vec3 arm = place - POSE(bone, 2), now = turned(POSE(bone, 1), arm);
  if (lookup.y > 0.0) now = mix(now, turned(POSE(bone, 3), arm), lookup.y);
  return POSE(bone, 0) + now - arm;
}
