// The workbench: what can be done, what is under way, and each of it as the command that does the same.

import { Bench, complaint } from "./bench.js";
import { showHistory, showSessions } from "./lists.js";
import { at, button, clean, filled, make } from "./make.js";
import { watchDrop } from "./dropped.js";
import { watchPlan } from "./plan.js";
import { SessionView } from "./session.js";
import { text } from "./texts.js";

const VIEWS = ["calibrate", "import", "sessions", "session", "history"];
const LOOKS = ["devices", "probe", "plan", "targets", "sessions", "history"]; // What the page asks for by itself.

const bench = new Bench(show);
const session = new SessionView(bench);
watchDrop(bench);
/** @type {Map<string, {name: string, says: string, values: any, noise?: any}>} */
const ports = new Map();
let chosen = "";
const askPlan = watchPlan(bench, () => ports.get(chosen)?.noise ?? {});
let isLooking = false;
let hasLooked = false;
let shown = "";

/** The part of the page that its address names, and the session behind it. */
const place = () => decodeURIComponent(location.hash.slice(1)).split("/");

function route() {
  const [view, ...rest] = place();
  const name = VIEWS.includes(view) ? view : "calibrate";
  for (const part of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-view]")))
    part.hidden = part.dataset.view !== name;
  for (const link of document.querySelectorAll("header a")) {
    const isHere = link.getAttribute("href") === `#${name === "session" ? "sessions" : name}`;
    if (isHere) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  const key = `${name}/${rest.join("/")}`;
  if (!bench.isThere || key === shown) return;
  // Who comes back from the guide calibrates at the same place.
  fillPlace(bench.newest("capture")?.values ?? {});
  shown = key;
  at("says").textContent = "";
  if (name === "calibrate" && !hasLooked) look();
  if (name === "sessions") bench.run("sessions").then((job) => showSessions(bench, job), refuse);
  if (name === "history") bench.run("history").then((job) => showHistory(bench, job), refuse);
  if (name === "session") session.open(rest.join("/"));
}

/** @param {Error} error */
function refuse(error) {
  at("says").textContent = error.message;
}

function show() {
  document.body.classList.toggle("away", !bench.isThere);
  at("link").textContent = bench.isThere ? "" : text("away");
  if (!bench.isThere) shown = "";
  route();
  knowVirtual();
  showUnderWay();
  showCommands();
  session.show();
}

// Where the instrument is

async function look() {
  if (isLooking) return;
  isLooking = hasLooked = true;
  at("look").disabled = true;
  try {
    for (const [key, port] of ports) if (!port.values.clock_speed) ports.delete(key);
    showPorts();
    const devices = await bench.found("devices");
    if (at("drivers").length === 1)
      for (const driver of devices.drivers)
        at("drivers").append(make("option", { value: driver.name }, `${driver.title} (${driver.name})`));
    for (const port of devices.ports)
      ports.set(port.device, {
        name: `${port.device} ${port.description}`,
        says: text("listening"),
        values: { port: port.device },
      });
    for (const bus of devices.buses)
      ports.set(bus.bus, {
        name: text("bus", { bus: bus.bus, state: bus.state }),
        says: text("onBus"),
        values: { bus: bus.bus },
      });
    showPorts();
    // Two at a time: a port that says nothing takes ten seconds, and other commands want their turn, too.
    const left = devices.ports.map((/** @type {any} */ port) => port.device);
    const next = async () => {
      while (left.length) await listen(left.shift());
    };
    await Promise.all([next(), next()]);
  } catch (error) {
    refuse(/** @type {Error} */ (error));
  }
  isLooking = false;
  at("look").disabled = false;
}

/** Ask what is on a port. @param {string} key */
async function listen(key) {
  const port = ports.get(key);
  if (!port) return;
  const job = await bench.run("probe", port.values);
  const probed = job.found[0]?.ports?.[0];
  if (probed?.found) {
    const who = Object.values(probed.identity).join(" ");
    port.says = [probed.found.title, who, text("frames", { frames: probed.found.frames }), ...probed.taken]
      .filter(Boolean)
      .join("; ");
    port.values = { ...port.values, driver: probed.found.name, ...(probed.baud ? { baud: probed.baud } : {}) };
    if (probed.found.noise_ug) port.noise = { noise_ug: probed.found.noise_ug };
    if (!chosen) chosen = key;
  } else port.says = text("unrecognised", { why: complaint(job) });
  showPorts();
}

function showPorts() {
  const rows = [...ports].map(([key, { name, says }]) =>
    make(
      "label",
      { class: "port" },
      make("input", {
        type: "radio",
        name: "where",
        value: key,
        ...(key === chosen ? { checked: true } : {}),
        onchange: () => {
          chosen = key;
          askPlan();
        },
      }),
      make("div", {}, make("strong", {}, name), make("span", {}, says)),
    ),
  );
  at("ports").replaceChildren(...(rows.length ? rows : [make("p", {}, text(isLooking ? "looking" : "noPort"))]));
  askPlan();
}

/** Virtual instruments are ports for as long as they run. */
function knowVirtual() {
  const before = [...ports.keys()].join();
  for (const [key, port] of ports) if (port.values.clock_speed) ports.delete(key);
  for (const job of bench.jobs.values()) {
    const started = job.code === null && job.action === "emulate" ? job.found.find((value) => value.event === "started") : null;
    if (!started) continue;
    ports.set(started.port, {
      name: text("virtual", { port: started.port }),
      says: text("virtualIs", { driver: started.driver, speed: started.speed }),
      values: { port: started.port, driver: started.driver, clock_speed: started.speed },
      noise: { grade: "tactical" }, // What `emulate` makes where nobody says otherwise.
    });
    if (!ports.has(chosen)) chosen = started.port;
  }
  if (before !== [...ports.keys()].join()) showPorts();
}

at("look").addEventListener("click", look);
at("virtual").addEventListener("click", async () => {
  try {
    const speed = 4; // So that 24 positions take two minutes, and a person can follow.
    const number = await bench.start("emulate", { driver: "stim300", speed });
    const started = await heard(number, (value) => value.event === "started");
    if (!started) return refuse(new Error(complaint(/** @type {any} */ (bench.jobs.get(number)))));
    chosen = started.port;
    knowVirtual();
    fillPlace({ latitude: 45, height: 0 });
  } catch (error) {
    refuse(/** @type {Error} */ (error));
  }
});

/** Fill in a place where none was given. @param {any} values */
function fillPlace(values) {
  const fields = at("place").elements;
  if (fields.latitude.value || fields.gravity.value) return;
  for (const name of ["latitude", "height", "gravity"]) fields[name].value = values[name] ?? "";
}

/** Wait for a value of a command, null when it has ended without. @param {number} number @param {(value: any) => boolean} fits @returns {Promise<any>} */
async function heard(number, fits) {
  for (;;) {
    const job = bench.jobs.get(number);
    const value = job?.found.find(fits);
    if (value || (job && job.code !== null)) return value ?? null;
    if (!bench.isThere) throw new Error(text("gone"));
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}

at("drivers").addEventListener("change", async (/** @type {any} */ event) => {
  const name = event.target.value;
  const job = name ? await bench.run("devices", { driver: name }).catch(refuse) : null;
  const facts = job?.found[0];
  at("driver").replaceChildren(
    ...(facts
      ? [
          make("p", {}, `${facts.title}: ${facts.status}. ${facts.wiring}`),
          make(
            "div",
            { class: "fields", id: "settings" },
            Object.entries(facts.settings).map(([key, { value, meaning, allowed }]) =>
              make(
                "label",
                { title: `${meaning}; ${allowed}` },
                `${key.replaceAll("_", " ")}: ${meaning}`,
                make("input", { "data-setting": key, placeholder: `${value} (${allowed})`, autocomplete: "off" }),
              ),
            ),
          ),
        ]
      : []),
  );
});

// The guide

at("start").addEventListener("click", async () => {
  const typed = filled(at("place-of-instrument"));
  const settings = [.../** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("[data-setting]"))]
    .filter((field) => field.value.trim())
    .map((field) => `${field.dataset.setting}=${field.value.trim()}`);
  const where = typed.port || typed.bus ? {} : ports.get(chosen)?.values;
  if (!where) {
    at("start-says").textContent = text("chooseFirst");
    return;
  }
  await begin("capture", {
    ...where,
    ...typed,
    ...filled(at("place")),
    ...filled(at("plan")),
    ...(settings.length ? { settings } : {}),
  });
});

/** Start a guided session and go to its page. @param {string} action @param {any} values */
async function begin(action, values) {
  const name = values.new ?? values.session;
  at("start-says").textContent = "";
  at("start").disabled = true;
  try {
    const number = await bench.start(action, values);
    const page = await heard(number, (value) => value.event === "page");
    if (page) goTo(page.url, name);
    else
      at(action === "capture" ? "start-says" : "session-says").textContent = complaint(
        /** @type {any} */ (bench.jobs.get(number)),
      );
    if (page) at("new-name").value = newName();
  } catch (error) {
    at(action === "capture" ? "start-says" : "session-says").textContent = /** @type {Error} */ (error).message;
  }
  at("start").disabled = false;
}
session.begin = begin;

/** Go to the page of a guide on this machine, which leads back here. @param {string} url @param {string} name */
function goTo(url, name) {
  if (!/^http:\/\/(127\.0\.0\.1|localhost):\d+\/#/.test(url)) return;
  location.hash = `session/${encodeURIComponent(name)}`;
  location.assign(`${url}&back=${encodeURIComponent(`${location.origin}/#session/${encodeURIComponent(name)}`)}`);
}

function newName() {
  const now = new Date().toISOString().replace(/[-:]|\.\d+/g, "");
  return `${now}-session`;
}
at("new-name").value = newName();

// What is under way, and what was done

/** @type {Map<number, {banner: any, words: any, newest: any, guide: any}>} by the number of the command */
const banners = new Map();

function showUnderWay() {
  const running = [...bench.jobs.values()].filter((job) => job.code === null && !LOOKS.includes(job.action));
  for (const [number, { banner }] of banners)
    if (!running.some((job) => job.job === number)) {
      banner.remove();
      banners.delete(number);
    }
  for (const job of running) {
    const name = job.values.new ?? job.values.session ?? "";
    const page = job.found.find((value) => value.event === "page");
    const counted = job.found.filter((value) => "accepted" in value && "planned" in value).pop();
    // Changed and not made anew: somebody may be about to press a button of it.
    const { words, newest, guide } = banners.get(job.job) ?? banner(job, name);
    words.textContent = clean(underWay(job, { name, accepted: counted?.accepted, planned: counted?.planned }, Boolean(page)));
    newest.textContent = job.action === "emulate" ? "" : clean(job.found.filter((value) => value.words).pop()?.words ?? "");
    guide.hidden = !page;
  }
}

/** Make the banner of a command. @param {import("./bench.js").Job} job @param {string} name */
function banner(job, name) {
  const [words, newest] = [make("strong"), make("span", { class: "state" })];
  const guide = button(
    text("openGuide"),
    () => goTo(bench.jobs.get(job.job)?.found.find((value) => value.event === "page")?.url ?? "", name),
    { class: "main" },
  );
  const stop = () => void bench.ask({ cancel: job.job }).catch(refuse);
  const made = {
    banner: make("div", {}, words, newest, guide, button(isGuided(job) ? text("pause") : text("stop"), stop)),
    words,
    newest,
    guide,
  };
  at("under-way").append(made.banner);
  banners.set(job.job, made);
  return made;
}

/** @param {import("./bench.js").Job} job */
const isGuided = (job) => job.action === "capture" || job.action === "resume";

/** @param {import("./bench.js").Job} job @param {any} counts @param {boolean} hasPage */
function underWay(job, counts, hasPage) {
  if (isGuided(job)) return counts.planned ? text("counted", counts) : text(hasPage ? "guided" : "connecting", counts);
  if (job.action === "emulate") return text("emulated");
  if (job.action === "replay") return text("replayed", counts);
  return job.action === "solve" ? text("computing", counts) : job.command;
}

/** @type {Map<number, {entry: any, said: number}>} */
const written = new Map();

function showCommands() {
  // What the page asks again and again by itself is shown once.
  const newest = new Map([...bench.jobs.values()].map((job) => [LOOKS.includes(job.action) ? job.command : job.job, job.job]));
  const shown = new Set(newest.values());
  for (const number of written.keys())
    if (!shown.has(number)) {
      written.get(number)?.entry.remove();
      written.delete(number);
    }
  for (const job of bench.jobs.values()) {
    if (!shown.has(job.job)) continue;
    const size = job.said.length + job.lines.length + (job.code === null ? 0 : 1);
    const before = written.get(job.job);
    if (before?.said === size) continue;
    const state =
      job.code === null
        ? text("running")
        : job.code === 0
          ? text("done")
          : job.code === 130
            ? text("stopped")
            : text("notDone", { why: complaint(job) });
    const words = [...job.lines, ...job.said].join("\n");
    const entry = make(
      "li",
      {},
      make("code", {}, job.command),
      " ",
      make("span", { class: job.code && job.code !== 130 ? "failed" : "state" }, state),
      words ? make("details", {}, make("summary", {}, text("says")), make("pre", {}, words)) : null,
    );
    if (before) before.entry.replaceWith(entry);
    else at("commands").prepend(entry);
    written.set(job.job, { entry, said: size });
  }
}

addEventListener("hashchange", route);
showPorts();
show();
