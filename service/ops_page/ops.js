// Asks every few seconds; only the key is stored, in this tab alone.
const REFRESH_MS = 5000;
const byId = (id) => document.getElementById(id);
const keyField = byId("key");
keyField.value = sessionStorage.getItem("dynamictree-key") ?? "";
keyField.addEventListener("change", () => {
  sessionStorage.setItem("dynamictree-key", keyField.value);
  refresh();
});

async function ask(path) {
  const headers = keyField.value ? { Authorization: `Bearer ${keyField.value}` } : {};
  const response = await fetch(path, { headers, cache: "no-store" });
  if (response.status === 401) byId("key-row").hidden = false;
  return response.json();
}

function fill(id, rows) {
  byId(id).replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    for (const cell of cells) {
      const [text, look] = Array.isArray(cell) ? cell : [cell, ""];
      const made = document.createElement("td");
      made.textContent = text ?? "";
      made.className = look;
      row.append(made);
    }
    return row;
  }));
}

const judged = (word) => [word, word === "ok" || word === "ready" ? "good" : "bad"];

function tell(ready, ops, jobs) {
  byId("status").textContent = ready.status;
  byId("status").className = judged(ready.status)[1];
  const { status, ...parts } = ready;
  fill("parts", Object.entries(parts).map(([name, word]) => [name, judged(word)]));
  if (ops.queues) {
    fill("queues", ops.queues.map((queue) => [queue.name, queue.jobs, queue.oldest_s.toFixed(1)]));
    const counts = Object.entries({ ...ops.jobs, ...prefixed("attempts ", ops.attempts) });
    fill("counts", [["workers", ops.workers], ["unsent messages", ops.unsent_messages], ...counts]);
  }
  if (jobs.data) fill("jobs", jobs.data.map(jobRow));
}

const prefixed = (prefix, counts) => Object.fromEntries(Object.entries(counts).map(([name, n]) => [prefix + name, n]));

function jobRow(job) {
  const stage = job.stages.find((known) => known.state === "running");
  const done = stage ? `${stage.name} ${Math.round(100 * stage.progress)} %` : "";
  const look = job.state === "failed" ? "bad" : job.state === "succeeded" ? "good" : "";
  return [job.id, job.type, [job.state, look], done, job.attempt, job.created_at, job.error?.code ?? ""];
}

async function refresh() {
  try {
    tell(...await Promise.all([ask("/readyz"), ask("/v1/ops"), ask("/v1/jobs?limit=20")]));
  } catch {
    byId("status").textContent = "does not answer";
    byId("status").className = "bad";
  }
}

await refresh();
setInterval(() => { if (!document.hidden) refresh(); }, REFRESH_MS);
