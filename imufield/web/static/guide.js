// The page of the guide: what the program says, drawn; and the marks that go back.

import { keepAwake } from "./awake.js";
import { Box } from "./box.js";
import { forgetColours } from "./canvas.js";
import { drawForecast, drawTrace } from "./chart.js";
import { drawGlobe } from "./globe.js";
import { Link, isOfThisMachine } from "./link.js";
import { at } from "./make.js";
import { drawnShape } from "./shape.js";
import { Sound } from "./sound.js";
import { text } from "./texts.js";

const MILLI_G = 9.80665e-3;
const LOG_LINES = 200;
const TRACE_BLOCKS = 300;
const SURE_MS = 10000; // As long as the program believes the second tap.
const ROUND = 2 * Math.PI * 52;
const ROWS = 8; // Of the list: turns about one axis stand below each other.
/** @type {Record<string, string>} */
const SIGNS = { accepted: "●", next: "◉", open: "○", suspect: "■", again: "↻", skipped: "×" };

/** @param {string} words as a terminal can show them @returns {string} */
const pretty = (words) => words.replaceAll("^2", "²").replace(/\bug\b/g, "µg").replace(/ deg\b/g, "°").replace(/(^|\W)-(?=[xyz\d])/g, "$1−");
/** @param {string} id @param {string} words changed only where they are others: each change is read out */
const write = (id, words) => {
  const element = at(id);
  if (element.textContent !== words) element.textContent = words;
};

const box = new Box(at("box"));
const sound = new Sound();
/** @type {any} */
let head = { positions: [] };
/** @type {any} */
let state = null;
/** @type {any} */
let map = { accepted: {}, suspects: [], skipped: [], again: [], forecasts: [] };
/** @type {(number | null)[][]} */
let blocks = [];
let role = "watch";
let asked = -Infinity;

linkBack();
const link = new Link(take, (isThere) => {
  document.body.classList.toggle("away", !isThere);
  write("link", isThere ? "" : text(state ? "away" : "never"));
});

/** Show the way back to a workbench of this machine, which stands in the address. */
function linkBack() {
  const given = new URLSearchParams(location.hash.slice(1)).get("back");
  if (given) sessionStorage.setItem("back", given);
  const back = sessionStorage.getItem("back") ?? "";
  // Another place, or a script, is no workbench: the address may come from anybody.
  if (!isOfThisMachine(back)) return;
  at("back").href = back;
  at("back").hidden = false;
}

/** @param {any} message */
function take(message) {
  if (message.role) {
    role = message.role;
    at("marks").hidden = role !== "mark";
  } else if (message.ended) end(message.ended);
  else show(message);
}

/** @param {any} message what is new, or everything where it has a head */
function show(message) {
  if (message.head) {
    head = message.head;
    blocks = [];
    at("log").firstElementChild.replaceChildren();
    write("about", [head.instrument, head.session, head.scheme, role === "watch" ? text("watching") : ""].filter(Boolean).join(" · "));
    box.cable = head.cable;
    if (head.shape) box.shape = drawnShape(head.shape);
  }
  if (!message.state.headline) return; // Nothing has been shown yet.
  state = message.state;
  if (message.map) map = message.map;
  if (message.trace) blocks = blocks.concat(message.trace).slice(-TRACE_BLOCKS);
  if (message.log) hear(message.log, Boolean(message.head));
  showWords();
  showStillness();
  box.up = state.up;
  box.goal = state.state === "holding" || state.state === "done" ? null : state.target_up;
  const isPaused = state.state === "paused";
  label("p", text(isPaused ? "go_on" : "pause"), isPaused);
  button("g").hidden = state.headline !== "WAIT";
  button("r").classList.toggle("wanted", state.big[0] === "PRESS");
  const places = positions();
  drawGlobe(at("globe"), places, state.up);
  if (message.map || message.head) showPositions(places);
  if (message.trace || message.head) drawTrace(at("trace"), blocks);
  document.body.dataset.version = message.version;
}

/** @param {string} key @returns {HTMLButtonElement} */
function button(key) {
  return at("marks").querySelector(`[data-key=${key}]`);
}

/** @param {string} key @param {string} words @param {boolean} isWanted whether the program waits for it */
function label(key, words, isWanted) {
  const span = /** @type {HTMLElement} */ (button(key).firstElementChild);
  if (span.textContent !== words) span.textContent = words;
  button(key).classList.toggle("wanted", isWanted);
}

/**
 * Add lines to the log; what is new sounds.
 * @param {any[]} lines @param {boolean} isOld
 */
function hear(lines, isOld) {
  const log = at("log").firstElementChild;
  for (const line of lines) {
    if (!isOld) sound.play(line.kind, line.tones);
    if (!line.text) continue; // To be heard only.
    const entry = document.createElement("li");
    entry.textContent = pretty(line.text);
    entry.className = line.kind;
    log.prepend(entry);
  }
  // What was said together is not cut off by its last part.
  const spoken = lines.map((line) => line.spoken).filter(Boolean);
  if (!isOld && spoken.length) sound.say(spoken.join(". "));
  while (log.children.length > LOG_LINES) log.lastChild.remove();
}

function showWords() {
  document.body.dataset.mood = state.mood;
  document.body.dataset.state = state.state;
  write("headline", state.headline);
  const side = /^[+-]/.test(state.big[1]) ? state.big[1] : "";
  write("side", side && text("side", { side: side.replaceAll("-", "−").replace(/(.)([+−])/g, "$1 $2") }));
  write("details", pretty(state.details));
  const [, done] = at("ring").querySelectorAll("circle");
  const number = at("ring").querySelector("text");
  // The same ring, which fills: on the way to the goal with the angle that is left, in a hold with the seconds.
  const share = state.fraction ?? (state.angle_deg === null ? null : 1 - state.angle_deg / 180);
  number.textContent = state.fraction === null ? `${Math.round(state.angle_deg)}°` : `${Math.ceil(state.remaining_s ?? 0)} s`;
  done.style.strokeDasharray = `${ROUND * (share ?? 0)} ${ROUND}`;
  at("ring").classList.toggle("shown", share !== null);
  write("done", String(state.done));
  write("planned", String(state.planned));
  const parts = [];
  if (state.rate_hz !== null) parts.push(text("rate", { rate: Math.round(state.rate_hz) }));
  parts.push(state.samples_lost ? text("samples_lost", { count: state.samples_lost }) : text("none_lost"));
  write("rate", parts.join(" · "));
  write("link", state.link === "there" ? "" : text(state.link));
}

function showStillness() {
  const ratio = state.stillness ? state.stillness.ratio : 0;
  at("stillness").classList.toggle("moving", ratio > 1);
  at("stillness").querySelector(".measured").style.transform = `scaleX(${Math.min(ratio / 2, 1)})`;
  at("stillness").querySelector("[role=meter]").setAttribute("aria-valuenow", String(Math.round(100 * Math.min(ratio, 2))));
  write("calm", state.stillness ? text(ratio > 1 ? "moving" : "still") : "");
  write("cause", state.stillness ? pretty(state.stillness.words) : "");
}

/** @returns {{name: string, up: any, words: string, state: string, residual: number | null}[]} */
function positions() {
  return head.positions.map((/** @type {any} */ position) => {
    const { name } = position;
    const accepted = map.accepted[name];
    // The first that applies, as in the terminal.
    const kinds = [
      ["next", state.state !== "done" && (name === state.position || name === state.target)],
      ["skipped", map.skipped.includes(name)],
      ["again", map.again.includes(name)],
      ["suspect", map.suspects.includes(name)],
      ["accepted", accepted],
    ];
    const residual = typeof accepted?.residual_m_s2 === "number" ? accepted.residual_m_s2 / MILLI_G : null;
    return { ...position, state: kinds.find(([, applies]) => applies)?.[0] ?? "open", residual };
  });
}

/** @param {ReturnType<typeof positions>} places */
function showPositions(places) {
  const named = [...places].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
  const rows = named.map((position) => {
    const row = document.createElement("li");
    row.className = position.state;
    row.title = position.words;
    const size = Math.abs(position.residual ?? 0);
    const residual = position.residual === null ? "" : `${position.residual < 0 ? "−" : "+"}${size.toFixed(size < 10 ? 2 : 1)}`;
    const parts = [
      ["sign", SIGNS[position.state]],
      ["name", position.name.replaceAll("-", "−")],
      ["unseen", [text(position.state), residual && text("residual", { residual })].filter(Boolean).join(", ")],
      ["residual", residual],
    ];
    for (const [kind, words] of parts) {
      const part = document.createElement("span");
      part.className = kind;
      part.textContent = words;
      if (kind === "sign" || kind === "residual") part.setAttribute("aria-hidden", "true");
      row.append(part);
    }
    return row;
  });
  at("positions").style.gridTemplateRows = `repeat(${Math.min(ROWS, rows.length)}, auto)`;
  at("positions").replaceChildren(...rows);
  const signs = Object.entries(SIGNS).map(([kind, sign]) => `${sign} ${text(kind)}`);
  write("legend", text("legend", { signs: signs.join("  ") }));
  const known = Object.values(state.known ?? {}).map(pretty);
  drawForecast(at("forecast"), map.forecasts, state.planned, known);
  at("forecast").hidden = !map.forecasts.length;
  write("known", state.known ? "" : text("accuracy_later"));
}

/** @param {{headline: string, details: string}} last */
function end(last) {
  link.end();
  document.body.classList.remove("away");
  document.body.dataset.mood = "plain";
  document.body.dataset.state = "ended";
  write("headline", last.headline);
  write("side", "");
  write("details", last.details);
  write("link", "");
  write("cause", text("gone"));
  write("calm", "");
  box.goal = null;
  at("ring").classList.remove("shown");
  at("marks").hidden = true;
  sound.say(`${last.headline}. ${last.details}`);
}

/** @param {string} key */
function mark(key) {
  link.send(key);
  if (key !== "f") return;
  // The program asks for a second tap itself; the button says so.
  const isSure = performance.now() - asked < SURE_MS;
  asked = isSure ? -Infinity : performance.now();
  label("f", text(isSure ? "finish" : "finish_sure"), !isSure);
  setTimeout(() => performance.now() - asked >= SURE_MS && label("f", text("finish"), false), SURE_MS + 50);
}

at("marks").addEventListener("click", (/** @type {any} */ event) => {
  const key = event.target.closest("button")?.dataset.key;
  if (key) mark(key);
});
document.addEventListener("keydown", (event) => {
  const isPlain = !event.repeat && !event.ctrlKey && !event.altKey && !event.metaKey;
  if (role === "mark" && isPlain && event.key.length === 1 && "rsupgf".includes(event.key)) mark(event.key);
});
at("sound").addEventListener("click", () => at("sound").setAttribute("aria-pressed", String(sound.toggle())));
at("voice").addEventListener("click", () => {
  sound.voice = !sound.voice;
  at("voice").setAttribute("aria-pressed", String(sound.voice));
  if (sound.voice) sound.say(at("words").innerText);
});

/** Draw everything in the colours of day or night. */
function recolour() {
  const root = document.documentElement;
  const isDark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  at("night").setAttribute("aria-pressed", String(isDark));
  forgetColours();
  if (state) redraw();
}

function redraw() {
  drawTrace(at("trace"), blocks);
  showPositions(positions());
}

const kept = sessionStorage.getItem("theme");
if (kept) document.documentElement.dataset.theme = kept;
at("night").addEventListener("click", () => {
  const theme = at("night").getAttribute("aria-pressed") === "true" ? "light" : "dark";
  document.documentElement.dataset.theme = theme;
  sessionStorage.setItem("theme", theme);
  recolour();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
recolour();
addEventListener("resize", () => state && redraw());
keepAwake((isAwake) => write("awake", text(isAwake ? "awake" : "asleep")));
