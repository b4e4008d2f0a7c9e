// The page of the guide: what the program says, drawn; and the marks that go back.

import { keepAwake } from "./awake.js";
import { Box } from "./box.js";
import { drawGlobe } from "./globe.js";
import { Link } from "./link.js";
import { Sound } from "./sound.js";
import { drawTrace } from "./trace.js";

const MILLI_G = 9.80665e-3;
const LOG_LINES = 200;
const TRACE_BLOCKS = 300;
const SURE_MS = 10000; // As long as the program believes the second tap.
const ROUND = 2 * Math.PI * 54;

/** @param {string} id @returns {any} */
const at = (id) => document.getElementById(id);

const box = new Box(at("box"));
const sound = new Sound();
/** @type {any} */
let head = { positions: [] };
/** @type {any} */
let state = null;
/** @type {any} */
let map = { accepted: {}, suspects: [], skipped: [] };
/** @type {(number | null)[][]} */
let blocks = [];
let role = "watch";
let spoken = "";

const link = new Link(take, (isThere) => {
  document.body.classList.toggle("away", !isThere);
  if (!isThere) at("link").textContent = "no connection to the program; trying again";
});

/** @param {any} message */
function take(message) {
  if (message.role) {
    role = message.role;
    at("marks").hidden = role !== "mark";
    return;
  }
  if (message.ended) {
    link.end();
    [at("headline").textContent, at("details").textContent, document.body.dataset.state] = [message.ended.headline, message.ended.details, "ended"];
    return;
  }
  const whole = Boolean(message.head);
  if (whole) {
    head = message.head;
    blocks = [];
    at("log").replaceChildren();
    at("about").textContent = [head.instrument, head.session, head.scheme].filter(Boolean).join(" · ");
    box.cable = head.cable;
  }
  state = message.state;
  if (message.map) map = message.map;
  if (message.trace) blocks = blocks.concat(message.trace).slice(-TRACE_BLOCKS);
  if (message.log) hear(message.log, whole);
  show();
  if (message.map || whole) showPositions();
  if (message.trace) drawTrace(at("trace"), blocks);
}

/**
 * Add lines to the log; what is new sounds.
 * @param {any[]} lines @param {boolean} isOld
 */
function hear(lines, isOld) {
  const log = at("log");
  for (const line of lines) {
    const entry = document.createElement("li");
    entry.textContent = line.text;
    entry.className = line.kind;
    log.prepend(entry);
    if (!isOld) sound.play(line.kind);
  }
  while (log.children.length > LOG_LINES) log.lastChild.remove();
}

function show() {
  document.body.dataset.mood = state.mood;
  document.body.dataset.state = state.state;
  if (at("headline").textContent !== state.headline) at("headline").textContent = state.headline;
  if (at("details").textContent !== state.details) at("details").textContent = state.details;
  const words = `${state.headline}. ${state.details}`;
  if (words !== spoken) {
    spoken = words;
    sound.say(words);
    if (state.state === "holding") sound.play("hold");
  }
  box.up = state.up;
  box.goal = state.state === "holding" || state.state === "done" ? null : state.target_up;
  const [, done] = at("ring").querySelectorAll("circle");
  done.style.strokeDasharray = `${ROUND * (state.fraction ?? 0)} ${ROUND}`;
  at("ring").querySelector("text").textContent = state.remaining_s === null ? "" : String(Math.ceil(state.remaining_s));
  at("ring").classList.toggle("shown", state.fraction !== null);
  const [meter, measured] = [at("stillness").querySelector("meter"), at("stillness").querySelector(".words")];
  meter.value = state.stillness ? Math.min(state.stillness.ratio, 2) : 0;
  measured.textContent = !state.stillness ? "" : state.stillness.ratio <= 1 ? "still" : `${state.stillness.motion} (${state.stillness.axis})`;
  at("done").textContent = state.done;
  at("planned").textContent = state.planned;
  const known = state.known;
  at("known").textContent = known
    ? `known to (1 sigma): bias ${known.bias_ug}, scale ${known.scale_ppm}, angles ${known.misalignment_urad}`
    : "accuracy is shown from position 4 on";
  const parts = [];
  if (state.rate_hz !== null) parts.push(`${Math.round(state.rate_hz)} samples/s`);
  if (state.temperature_degc !== null) parts.push(`${state.temperature_degc.toFixed(1)} °C`);
  parts.push(state.samples_lost ? `${state.samples_lost} samples lost` : "no sample lost");
  at("rate").textContent = parts.join(" · ");
  at("link").textContent = { there: "", lost: "the link to the instrument is lost", silent: "the instrument sends nothing" }[state.link] ?? "";
  const pause = at("marks").querySelector("[data-key=p]");
  const isPaused = state.state === "paused";
  pause.textContent = isPaused ? pause.dataset.words : "pause";
  drawGlobe(at("globe"), positions(), state.up);
}

/** @returns {{name: string, up: any, words: string, state: string, residual: number | null}[]} */
function positions() {
  return head.positions.map((/** @type {any} */ position) => {
    const accepted = map.accepted[position.name];
    const now = state && (position.name === state.position || position.name === state.target);
    const kind = map.suspects.includes(position.name)
      ? "suspect"
      : now
        ? "next"
        : accepted
          ? "accepted"
          : map.skipped.includes(position.name)
            ? "skipped"
            : "open";
    const residual = accepted && typeof accepted.residual_m_s2 === "number" ? accepted.residual_m_s2 / MILLI_G : null;
    return { ...position, state: kind, residual };
  });
}

function showPositions() {
  const rows = positions().map((position) => {
    const row = document.createElement("tr");
    row.className = position.state;
    const cells = [position.name, position.state, position.residual === null ? "" : position.residual.toFixed(2)].map((text) => {
      const cell = document.createElement("td");
      cell.textContent = text;
      return cell;
    });
    cells[0].title = position.words;
    cells[2].className = "number";
    row.append(...cells);
    return row;
  });
  at("table").querySelector("tbody").replaceChildren(...rows);
}

let asked = 0;
at("marks").addEventListener("click", (/** @type {any} */ event) => {
  const button = event.target.closest("button");
  if (!button) return;
  const isAgain = button.dataset.again && state && state.state === "paused";
  link.mark(isAgain ? button.dataset.again : button.dataset.key);
  if (button.dataset.key !== "f") return;
  // The program asks for a second tap itself; the button says so.
  button.textContent = performance.now() - asked < SURE_MS ? "finish" : "tap again to finish";
  asked = performance.now();
  setTimeout(() => (button.textContent = "finish"), SURE_MS);
});
document.addEventListener("keydown", (event) => {
  if (role === "mark" && !event.repeat && !event.ctrlKey && !event.altKey && !event.metaKey && "rsupgf".includes(event.key)) link.mark(event.key);
});
at("sound").addEventListener("click", (/** @type {any} */ event) => event.target.setAttribute("aria-pressed", String(sound.toggle())));
at("voice").addEventListener("click", (/** @type {any} */ event) => {
  sound.voice = !sound.voice;
  event.target.setAttribute("aria-pressed", String(sound.voice));
  if (sound.voice) sound.say(spoken);
});
at("day").addEventListener("click", (/** @type {any} */ event) => {
  const isDark = matchMedia("(prefers-color-scheme: dark)").matches;
  const root = document.documentElement;
  root.dataset.theme = root.dataset.theme ? "" : isDark ? "light" : "dark";
  event.target.setAttribute("aria-pressed", String(Boolean(root.dataset.theme)));
  box.recolour();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => box.recolour());
addEventListener("resize", () => {
  if (blocks.length) drawTrace(at("trace"), blocks);
});
keepAwake((words) => (at("awake").textContent = words));
