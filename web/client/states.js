// States of a job.

const ENDED = new Set(["succeeded", "failed", "canceled"]);

/** Whether there is a small picture of its tree. */
export const hasStill = ({ type, state }) => type === "animate" && state === "succeeded";

export const hasEnded = (job) => ENDED.has(job.state);
