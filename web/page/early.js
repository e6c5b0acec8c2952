// Runs before the page's other modules are there: where the page opens with the welcome, its tree is loaded meanwhile.
// What a script imports by itself, the page's load event does not wait for. Until that event a browser turns a circle in
// its tab, and where it draws in software, each picture of the circle stops all of WebGL.

import { fetchExample, linkedJob } from "./example.js";

/** The files of the welcome's tree; null where the page opens with a job. */
const files = linkedJob() ? null : fetchExample();
files?.catch(() => {}); // the page works without it

/** The page's parts, for tests. */
export const page = import("./begin.js").then(({ begin }) => begin(files));
