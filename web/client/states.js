// States of a job.

const ENDED = new Set(["succeeded", "failed", "canceled", "aborted"]);

export const hasEnded = (job) => ENDED.has(job.state);
