// The picture, again and again: time goes on, what moves is drawn, what is pulled is sent.

const LONGEST_S = 0.5; // a tab that was in the background goes on from where it was

/** Draw the scene's tree for ever; `body[data-frames]` and `body[data-sharp]` say how far it is; `parts.onDraw()` follows each. */
export function runFrames(parts) {
  const { stage, player, scene, hand } = parts;
  const { dataset } = document.body;
  stage.prepare = (renderer) => scene.tree?.prepare(renderer);
  let last = performance.now();
  const next = (now) => {
    const seconds = Math.min((now - last) / 1000, LONGEST_S);
    last = now;
    if (!stage.immersed) stage.controls.update();
    player.advance(seconds);
    const empty = !scene.tree && !scene.draft; // in full it would take as long as a tree that comes
    if (stage.draw(now, empty)) {
      dataset.frames = String(Number(dataset.frames ?? 0) + 1);
      parts.onDraw?.();
    }
    dataset.sharp = String((empty || stage.resolution.sharp) && !stage.stale);
    hand.tick();
  };
  stage.renderer.setAnimationLoop(next);
}
