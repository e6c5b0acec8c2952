// What shiny surfaces reflect: sky above, haze at the horizon, earth below, in the theme's colours.

import * as THREE from "three";

const [WIDTH, HEIGHT] = [128, 64]; // cubes of a quarter of the width, 16 at least
const HAZE = 0.12; // of the height, on either side of the horizon

/** An environment for materials with metal or roughness, filtered for every roughness. */
export function environmentOf(renderer, { sky, earth }) {
  const [high, low] = [new THREE.Color(sky), new THREE.Color(earth)];
  const haze = high.clone().lerp(low, 0.35);
  const texels = new Float32Array(4 * WIDTH * HEIGHT);
  const colour = new THREE.Color();
  for (let row = 0; row < HEIGHT; row++) {
    const lift = (row + 0.5) / HEIGHT - 0.5; // -0.5 straight down, 0.5 straight up
    const share = Math.min(Math.abs(lift) / HAZE, 1);
    colour.copy(haze).lerp(lift > 0 ? high : low, share);
    for (let column = 0; column < WIDTH; column++) texels.set([...colour, 1], 4 * (row * WIDTH + column));
  }
  const picture = new THREE.DataTexture(texels, WIDTH, HEIGHT, THREE.RGBAFormat, THREE.FloatType);
  picture.mapping = THREE.EquirectangularReflectionMapping;
  picture.needsUpdate = true;
  const filter = new THREE.PMREMGenerator(renderer);
  const { texture } = filter.fromEquirectangular(picture);
  filter.dispose();
  picture.dispose();
  return texture;
}
