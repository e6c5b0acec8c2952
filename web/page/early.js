// Runs before the page's other modules are there: where the page opens with the welcome, its tree is loaded meanwhile,
// and the browser's graphics begin to run.

import { drawsInSoftware } from "../draw/software.js";
import { fetchExample, linkedJob } from "./example.js";

/** The files of the welcome's tree; null where the page opens with a job. */
export const early = linkedJob() ? null : fetchExample();
early?.catch(() => {}); // the page works without it
drawsInSoftware();
