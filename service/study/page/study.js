// One pair of films after another. The page never learns which method made which.
const SIDES = ["left", "right"];
const ANSWERS = { left: "Left", equal: "No difference", right: "Right" };
const byId = (id) => document.getElementById(id);

function film(address, kind) {
  const made = document.createElement(kind === "video" ? "video" : "img");
  if (kind === "video") Object.assign(made, { loop: true, muted: true, autoplay: true, playsInline: true });
  made.src = address;
  return made;
}

function question(name, [title, text]) {
  const set = document.createElement("fieldset");
  const legend = document.createElement("legend");
  legend.textContent = `${title}. ${text}`;
  set.append(legend);
  for (const [value, word] of Object.entries(ANSWERS)) {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"), { type: "radio", name, value, required: true });
    label.append(input, ` ${word}`);
    set.append(label);
  }
  return set;
}

async function begin() {
  const { trial, answered, of, questions } = await answerOf(await fetch("/next"));
  byId("progress").textContent = trial ? `Pair ${answered + 1} of ${of}` : "";
  byId("trial").hidden = !trial;
  byId("done").hidden = Boolean(trial);
  if (!trial) return;
  const films = SIDES.map((side) => film(trial[side], trial.kind));
  SIDES.forEach((side, index) => byId(side).replaceChildren(films[index]));
  if (trial.kind === "video") {
    await Promise.all(films.map((one) => new Promise((resolve) => one.addEventListener("canplay", resolve, { once: true }))));
    for (const one of films) one.currentTime = 0;
  }
  byId("questions").replaceChildren(...Object.entries(questions).map(([name, texts]) => question(name, texts)));
  byId("trial").onsubmit = (event) => {
    event.preventDefault();
    const body = JSON.stringify(Object.fromEntries(new FormData(event.target)));
    const sent = fetch(`/trials/${trial.id}`, { method: "POST", headers: { "content-type": "application/json" }, body });
    sent.then(answerOf).then(begin).catch(tell);
  };
}

async function answerOf(response) {
  const body = await response.json();
  if (!response.ok) throw new Error(typeof body.detail === "string" ? body.detail : `the study answers ${response.status}`);
  return body;
}

function tell(error) {
  byId("problem").hidden = false;
  byId("problem").textContent = `${error.message}. Load the page again to go on where you were.`;
}

begin().catch(tell);
