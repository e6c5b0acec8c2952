// Runs before the page's other modules are there: the tree that the page opens with is loaded meanwhile.
// What a script imports by itself, the page's load event does not wait for. Until that event a browser turns a circle in
// its tab, and where it draws in software, each picture of the circle stops all of WebGL.

import { fetchExample, fetchMotion, linkedJob } from "./example.js";

const job = linkedJob();
if (job) document.body.dataset.state = "queued"; // the welcome is not drawn before
/** The files of the welcome's tree, or the `fetch` of a job that the page opens with. */
const begun = job ? { fetch: fetchMotion(job) } : { files: fetchExample() };
(job ? import("../app.js") : begun.files).catch(() => {}); // it works without

/** The page's parts, for tests. */
export const page = import("./begin.js").then(({ begin }) => begin(begun));
