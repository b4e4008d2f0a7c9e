// The page of the guide: what the program says, drawn; and the marks that go back.

import { keepAwake } from "./awake.js";
import { Box } from "./box.js";
import { forgetColours } from "./canvas.js";
import { drawForecast, drawTrace } from "./chart.js";
import { drawGlobe } from "./globe.js";
import { Link, isOfThisMachine } from "./link.js";
import { at, make } from "./make.js";
import { drawnShape } from "./shape.js";
import { Sound } from "./sound.js";
import { signed, text, withMarks, withSigns } from "./texts.js";

const QUIET_MS = 10000; // The guide tells its state many times a second; opening a port again takes some seconds.
const ROUND = 2 * Math.PI * 52;
/** @type {Record<string, string>} */
const SIGNS = { accepted: "●", next: "◉", here: "@", open: "○", suspect: "■", again: "↻", skipped: "×" };

/** @param {string} words as a terminal can show them, marks by their names @returns {string} */
const pretty = (words) => withSigns(withMarks(words, role === "mark" ? "tap" : "named"));
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
let map = { accepted: {}, suspects: [], skipped: [], again: [], target: null, position: null, forecasts: [] };
/** @type {(number | null)[][]} */
let blocks = [];
let role = "watch";
let sureUntil = -Infinity;
let toldMs = Date.now(); // By the clock of the day, as the link counts.

linkBack();
const link = new Link(take, (isThere) => {
  document.body.classList.toggle("away", !isThere);
  write("link", isThere ? "" : text(state ? "away" : link.token ? "never" : "no_token"));
  if (!state) write("headline", text(isThere ? "connecting" : "not_connected"));
});

// The program answers for its guide, too, where that hangs. A recording may have gaps.
setInterval(() => {
  const isQuiet = state && head.replay_speed === null && Date.now() - toldMs > QUIET_MS;
  if (isQuiet && !link.ended && !document.body.classList.contains("away")) write("link", text("quiet", { seconds: QUIET_MS / 1000 }));
}, 1000);

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
    const speed = head.replay_speed;
    const isLive = speed === null;
    write("about", [head.instrument, head.session, head.scheme, role === "watch" && isLive ? text("watching") : ""].filter(Boolean).join(" · "));
    write("recording", isLive ? "" : speed ? text("recording", { speed }) : text("recording_fast"));
    write("span", text("span", { seconds: head.trace_s }));
    box.cable = head.cable;
    if (head.shape) box.shape = drawnShape(head.shape);
  }
  if (!message.state.headline) return; // Nothing has been shown yet.
  state = message.state;
  // A page that comes back is told what it knows.
  if (document.body.dataset.version !== String(message.version)) toldMs = Date.now();
  if (message.map) map = message.map;
  if (message.trace) blocks = blocks.concat(message.trace).slice(-head.trace_blocks);
  if (message.log) hear(message.log, Boolean(message.head));
  showWords();
  showStillness();
  box.up = state.up;
  box.goal = state.state === "holding" || state.state === "done" ? null : state.target_up;
  for (const each of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("[data-mark]")))
    each.disabled = !state.marks.includes(each.dataset.mark);
  const isPaused = state.now === "paused";
  label("pause", text(isPaused ? "go_on" : "pause"), isPaused);
  button("go_on").hidden = button("go_on").disabled;
  button("retake").classList.toggle("wanted", state.now === "suspect");
  const places = positions();
  drawGlobe(at("globe"), places, state.up);
  if (message.map || message.head) showPositions(places);
  if (message.trace || message.head) drawTrace(at("trace"), blocks, head.trace_s);
  document.body.dataset.version = message.version;
}

/** @param {string} mark @returns {HTMLButtonElement} */
function button(mark) {
  return at("marks").querySelector(`[data-mark=${mark}]`);
}

/** @param {string} mark @param {string} words @param {boolean} isWanted whether the program waits for it */
function label(mark, words, isWanted) {
  const span = /** @type {HTMLElement} */ (button(mark).firstElementChild);
  if (span.textContent !== words) span.textContent = words;
  button(mark).classList.toggle("wanted", isWanted);
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
    const pieces = pretty(line.text).split("`");
    log.prepend(make("li", { class: line.kind }, pieces.map((words, k) => (k % 2 ? make("code", {}, words) : words))));
  }
  // What was said together is not cut off by its last part.
  const spoken = lines.map((line) => line.spoken).filter(Boolean);
  if (!isOld && spoken.length) sound.say(spoken.join(". "));
  while (log.children.length > head.log_lines) log.lastChild.remove();
}

function showWords() {
  document.body.dataset.mood = state.mood;
  document.body.dataset.state = state.state;
  write("headline", state.headline);
  const side = state.side && text("side", { side: withSigns(state.side).replace(/(.)([+−])/g, "$1 $2") });
  write("side", state.now === "suspect" && role === "mark" ? pretty("[retake]") : side);
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
  write("link", state.link === "silent" ? text("silent") : ""); // Of one that is lost the headline speaks.
}

function showStillness() {
  const ratio = state.stillness ? state.stillness.ratio : 0;
  at("stillness").classList.toggle("moving", ratio > 1);
  at("stillness").querySelector(".measured").style.transform = `scaleX(${Math.min(ratio / 2, 1)})`;
  at("stillness").querySelector("[role=meter]").setAttribute("aria-valuenow", String(Math.round(100 * Math.min(ratio, 2))));
  write("calm", state.stillness ? text(ratio > 1 ? "moving" : "still") : "");
  write("cause", state.stillness ? pretty(state.stillness.words) : "");
}

/** @returns {{name: string, up: any, words: string, state: string, leaveOneOut: number | null}[]} */
function positions() {
  const isOver = state.state === "done" || document.body.dataset.state === "ended";
  return head.positions.map((/** @type {any} */ position) => {
    const { name } = position;
    const accepted = map.accepted[name];
    // The first that applies, as in the terminal.
    const kinds = [
      ["here", !isOver && name === map.position],
      ["next", !isOver && name === map.target],
      ["skipped", map.skipped.includes(name)],
      ["again", map.again.includes(name)],
      ["suspect", map.suspects.includes(name)],
      ["accepted", accepted],
    ];
    return { ...position, state: kinds.find(([, applies]) => applies)?.[0] ?? "open", leaveOneOut: accepted?.leave_one_out_mg ?? null };
  });
}

/** @param {ReturnType<typeof positions>} places */
function showPositions(places) {
  const named = [...places].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
  const rows = named.map((position) => {
    const size = Math.abs(position.leaveOneOut ?? 0);
    const off = position.leaveOneOut === null ? "" : signed(position.leaveOneOut, size < 10 ? 2 : 1);
    return make(
      "li",
      { class: position.state, title: withSigns(position.words) },
      make("span", { class: "sign", "aria-hidden": "true" }, SIGNS[position.state]),
      make("span", { class: "name" }, withSigns(position.name)),
      make("span", { class: "unseen" }, [text(position.state), off && text("leaveOneOut", { off })].filter(Boolean).join(", ")),
      make("span", { class: "off", "aria-hidden": "true" }, off),
    );
  });
  at("positions").replaceChildren(...rows);
  const signs = Object.entries(SIGNS).map(([kind, sign]) => `${sign}\u00a0${text(kind)}`);
  write("legend", text("legend", { signs: signs.join("  ") }));
  const known = Object.values(state.known ?? {}).map(pretty);
  drawForecast(at("forecast"), map.forecasts, state.planned, known);
  at("forecast").hidden = !map.forecasts.length;
  write("known", map.forecasts.length ? "" : text("accuracy_later"));
}

/** @param {{outcome: string, accepted: number, planned: number, lacking: string, command: string, reason: string}} last */
function end(last) {
  const { outcome, lacking, reason } = last;
  link.end();
  document.body.classList.remove("away");
  document.body.dataset.mood = outcome === "finished" ? "good" : "none";
  document.body.dataset.state = "ended";
  const then = at("back").hidden ? "next" : "back";
  at("back").classList.add("wanted");
  write("headline", text(outcome));
  write("side", "");
  const lines = [reason, text("measured", last), lacking, text(`${outcome}_${then}`)].filter(Boolean);
  const command = then === "next" ? last.command.split(" ").flatMap((word) => [" ", make("span", {}, word)]) : [];
  at("details").replaceChildren(lines.join("\n"), make("code", {}, command));
  write("link", "");
  write("cause", text("gone"));
  write("calm", "");
  box.goal = null;
  showPositions(positions());
  at("ring").classList.remove("shown");
  at("marks").hidden = true;
  sound.say(`${text(outcome)}. ${text("measured", last)}`);
}

/** @param {HTMLButtonElement} pressed */
function mark({ dataset }) {
  link.send(dataset.key ?? "");
  if (dataset.mark !== "finish") return;
  // The program asks for a second tap itself; the button says so.
  const [nowMs, againMs] = [performance.now(), 1000 * head.finish_again_s];
  const isSure = nowMs < sureUntil;
  sureUntil = isSure ? -Infinity : nowMs + againMs;
  label("finish", text(isSure ? "finish" : "finish_sure"), !isSure);
  setTimeout(() => performance.now() >= sureUntil && label("finish", text("finish"), false), againMs + 50);
}

at("marks").addEventListener("click", (/** @type {any} */ event) => {
  const pressed = event.target.closest("button");
  if (pressed) mark(pressed);
});
document.addEventListener("keydown", (event) => {
  if (role !== "mark" || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  const meant = [...at("marks").children].find(({ dataset, disabled }) => dataset.key === event.key && !disabled);
  if (meant) mark(meant);
});
at("sound").addEventListener("click", () => at("sound").setAttribute("aria-pressed", String(sound.toggle())));
at("voice").addEventListener("click", () => {
  sound.voice = !sound.voice;
  at("voice").setAttribute("aria-pressed", String(sound.voice));
  if (sound.voice) sound.say(at("words").innerText);
});

// What this browser lacks is not offered.
at("sound").hidden = !("AudioContext" in window);
at("voice").hidden = !("speechSynthesis" in window);

/** Draw everything in the colours of day or night. */
function recolour() {
  const root = document.documentElement;
  const isDark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  at("night").setAttribute("aria-pressed", String(isDark));
  forgetColours();
  if (state) redraw();
}

function redraw() {
  drawTrace(at("trace"), blocks, head.trace_s);
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
