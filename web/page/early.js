// Runs before the page's other modules are there: the tree that the page opens with is loaded meanwhile.
// What a script imports by itself, the page's load event does not wait for. Until that event a browser turns a circle in
// its tab, and where it draws in software, each picture of the circle stops all of WebGL.

import { fetchExample, fetchMotion, linkedJob } from "./example.js";

const job = linkedJob();
/** The files of the welcome's tree; null where the page opens with a job. */
const files = job ? null : fetchExample();
for (const begun of job ? [fetchMotion(job), import("../app.js")] : [files]) begun.catch(() => {}); // it works without

/** The page's parts, for tests. */
export const page = import("./begin.js").then(({ begin }) => begin(files));
