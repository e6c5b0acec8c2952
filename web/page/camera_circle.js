// Of a tree made of photos: from where they were taken, seen from above, and the side that none of them shows.

import { $, fill } from "./dom.js";
import { degrees, text } from "./texts.js";

const FILE = "report.json";
const WIDE_DEG = 40; // a gap that is worth a word, as the reconstruction warns of it

/** Draw the circle of a job's cameras where a side is missing; nothing where none is, or the job is of no photos. */
export async function showCameras(client, job, signal) {
  const file = (await client.artifacts(job.id)).find(({ name }) => name === FILE);
  if (!file || signal.aborted) return;
  const report = JSON.parse(new TextDecoder().decode(await client.bytes(file.url, { signal })));
  const gap = widestGap(Object.values(report.camera_azimuths_deg));
  $("camera-box").hidden = !gap;
  if (!gap || signal.aborted) return;
  const [first, second] = report.beside_largest_gap;
  fill($("camera-note"), text("cameras.gap", { angle: degrees(gap.to - gap.from), first, second }));
  $("camera-gap").setAttribute("d", sector(gap));
  $("camera-dots").setAttribute("d", Object.values(report.camera_azimuths_deg).map(dot).join(""));
}

/** `{ from, to }` of the widest angle between neighbours [deg], where it is wide; azimuths rise from 0 to 360. */
export function widestGap(azimuths) {
  const gaps = azimuths.map((from, i) => ({ from, to: azimuths[i + 1] ?? azimuths[0] + 360 }));
  const widest = gaps.reduce((best, gap) => (gap.to - gap.from > best.to - best.from ? gap : best), { from: 0, to: 0 });
  return widest.to - widest.from > WIDE_DEG ? widest : null;
}

/** Screens count downwards, azimuths counter-clockwise. */
const at = (deg, radius) => {
  const angle = (deg * Math.PI) / 180;
  return `${(radius * Math.cos(angle)).toFixed(1)} ${(-radius * Math.sin(angle)).toFixed(1)}`;
};

const sector = ({ from, to }) => `M0 0L${at(from, 46)}A46 46 0 ${Number(to - from > 180)} 0 ${at(to, 46)}Z`;
const dot = (deg) => `M${at(deg, 46)}h0`; // round ends make it a dot
