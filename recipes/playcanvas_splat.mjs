// A script for PlayCanvas 2.22: an animated splat sways. Put it and animated_splat.mjs into the project, give the
// script to an entity, and set `url` to a *.animated-splat.safetensors.

import * as pc from "playcanvas";
import { AnimatedSplat } from "./animated_splat.mjs";

export class TreeSplat extends pc.Script {
  static scriptName = "treeSplat";

  /** @attribute */
  url = "";

  async initialize() {
    this.splat = new AnimatedSplat(await (await fetch(this.url)).arrayBuffer());
    const { graphicsDevice: device } = this.app;
    const { count, box } = this.splat;
    this.container = new pc.GSplatContainer(device, count, pc.GSplatFormat.createDefaultFormat(device));
    this.container.aabb = new pc.BoundingBox(new pc.Vec3(...box.middle), new pc.Vec3(...box.half));
    const colours = Array.from({ length: count }, (_, g) => [...this.splat.colour(g), this.splat.opacity[g]]);
    this._fill("dataColor", colours.flat(), 4);
    this._move(0);
    this.entity.setLocalEulerAngles(-90, 0, 0); // +Z of the file is up
    this.entity.addComponent("gsplat", { resource: this.container, workBufferUpdate: pc.WORKBUFFER_UPDATE_ALWAYS });
    this.time = 0;
  }

  update(seconds) {
    if (!this.container) return;
    this.time = (this.time + seconds) % this.splat.seconds;
    this._move(this.time / this.splat.seconds);
    this.app.renderNextFrame = true; // where frames are drawn on demand, as in SuperSplat's viewer
  }

  _move(phase) {
    const { means, quaternions, scales } = this.splat.at(phase);
    this._fill("dataCenter", means, 3);
    this._fill("dataScale", scales, 3);
    this._fill("dataRotation", quaternions, 4);
    this.container.centers.set(means);
    this.container.update();
  }

  /** Numbers of each Gaussian, `width` of four a texel; as halves where the texture has such. */
  _fill(name, numbers, width) {
    const texture = this.container.getTexture(name);
    const pixels = texture.lock();
    const halves = pixels instanceof Uint16Array;
    for (let g = 0, at = 0; g < this.splat.count; g++)
      for (let i = 0; i < width; i++, at++)
        pixels[4 * g + i] = halves ? pc.FloatPacking.float2Half(numbers[at]) : numbers[at];
    texture.unlock();
  }
}
