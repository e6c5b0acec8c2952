// The sound of leaves, off until it is wanted: noise that grows and brightens with how far the wind moves the tree.

import { $ } from "./dom.js";

const LOOP_S = 5; // of noise; its ends meet without being heard
const LOUDEST = 0.35;
const HALF = 2.5; // motion, against that of the wind it was made for, at which half of it is reached
const [LOW_HZ, HIGH_HZ] = [900, 3800]; // middle of the band, of the faintest and the loudest rustle
const EASE_S = 0.25;
const STEP_MS = 100;

/** Noise in an AudioContext; gives a function that makes it as loud as leaves that move so far. */
export function rustle(context) {
  const noise = context.createBuffer(1, LOOP_S * context.sampleRate, context.sampleRate);
  noise.copyToChannel(
    Float32Array.from({ length: noise.length }, () => 2 * Math.random() - 1),
    0,
  );
  const source = new AudioBufferSourceNode(context, { buffer: noise, loop: true });
  const band = new BiquadFilterNode(context, { type: "bandpass", frequency: LOW_HZ, Q: 0.6 });
  const volume = new GainNode(context, { gain: 0 });
  source.connect(band).connect(volume).connect(context.destination);
  source.start();
  return (motion) => {
    const share = motion / (motion + HALF);
    volume.gain.setTargetAtTime(LOUDEST * share, context.currentTime, EASE_S);
    band.frequency.setTargetAtTime(LOW_HZ + (HIGH_HZ - LOW_HZ) * share, context.currentTime, EASE_S);
  };
}

/** Watch the box that turns it on; `motion()` says how far the tree moves now, 1 in its own wind. */
export function buildSound(motion) {
  let context = null;
  let timer = null;
  let follow = null;
  $("sound").onchange = () => {
    context ??= new AudioContext();
    follow ??= rustle(context);
    clearInterval(timer);
    if ($("sound").checked) timer = setInterval(() => follow(motion()), STEP_MS);
    context[$("sound").checked ? "resume" : "suspend"]();
  };
}
