// The workbench: what can be done, what is under way, and each of it as the command that does the same.

import { Bench, complaint } from "./bench.js";
import { showHistory, showSessions } from "./lists.js";
import { at, button, clean, filled, make, stamp, sureButton } from "./make.js";
import { watchDrop } from "./dropped.js";
import { watchPlan } from "./plan.js";
import { SessionView } from "./session.js";
import { isOfThisMachine } from "./link.js";
import { text, withMarks, withSigns } from "./texts.js";

const VIEWS = ["calibrate", "import", "sessions", "session", "history"];
const LOOKS = ["devices", "probe", "plan", "targets", "sessions", "history"]; // What the page asks for by itself.
const VIRTUAL = { driver: "stim300", latitude: 45, height: 0, speed: 4 }; // 24 positions in two minutes: a person can follow.

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
  if (name === "sessions") list("list", showSessions);
  if (name === "history") list("instruments", showHistory);
  if (name === "session") session.open(rest.join("/"));
}

/** Show what the folder holds, of which the command is the name of the part. @param {string} id @param {(bench: Bench, job: any) => void} showAll */
function list(id, showAll) {
  if (!at(id).childElementCount) at(id).replaceChildren(make("p", { role: "status" }, text("listing")));
  bench.run(place()[0]).then((job) => showAll(bench, job), refuse);
}

/** @param {Error} error */
function refuse(error) {
  at("says").textContent = error.message;
}

function show() {
  document.body.classList.toggle("away", !bench.isThere);
  at("link").textContent = bench.isThere ? "" : text(bench.isUnknown ? "unknown" : "away");
  if (!bench.isThere) shown = "";
  route();
  showUnderWay();
  showCommands();
  session.show();
}

// Where the instrument is

async function look() {
  if (isLooking) return;
  isLooking = hasLooked = true;
  at("look").disabled = true;
  // What was said of the port before may be over.
  for (const id of ["says", "start-says"]) at(id).textContent = "";
  try {
    for (const [key, port] of ports) if (!port.values.isVirtual) ports.delete(key);
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
        onchange: () => choose(key),
      }),
      make("div", {}, make("strong", {}, name), make("span", {}, says)),
    ),
  );
  at("ports").replaceChildren(...(rows.length ? rows : [make("p", {}, text(isLooking ? "looking" : "noPort"))]));
  askPlan();
}

/** @param {string} key */
function choose(key) {
  chosen = key;
  at("start-says").textContent = "";
  askPlan();
}

at("look").addEventListener("click", look);
at("virtual").addEventListener("click", () => {
  const key = bench.head.virtual;
  ports.set(key, { name: text("virtual"), says: text("virtualIs", VIRTUAL), values: { isVirtual: true }, noise: { grade: "tactical" } });
  fillPlace(VIRTUAL);
  choose(key);
  showPorts();
});

/** Start the virtual instrument, which ends with the session that reads it, or join the one that runs. @returns {Promise<any>} */
async function startVirtual() {
  const number = await bench.start("emulate", { speed: VIRTUAL.speed });
  const { port, driver, speed } = await heard(number, "started");
  return { port, driver, clock_speed: speed };
}

/** Fill in a place where none was given. @param {any} values */
function fillPlace(values) {
  const fields = at("place").elements;
  if (fields.latitude.value || fields.gravity.value) return;
  for (const name of ["latitude", "height", "gravity"]) fields[name].value = values[name] ?? "";
}

/** Wait for an event of a command; refuses where it ends without. @param {number} number @param {string} event @returns {Promise<any>} */
async function heard(number, event) {
  for (;;) {
    const job = bench.jobs.get(number);
    if (job?.told[event]) return job.told[event];
    if (job && job.code !== null) throw new Error(complaint(job));
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

/**
 * Start a guided session or its replay, and go to its page.
 * @param {string} action @param {any} asked what the command takes, and `isVirtual` where its instrument has to be started, too
 */
async function begin(action, { isVirtual, ...asked }) {
  const says = at(action === "capture" ? "start-says" : "session-says");
  says.textContent = "";
  const place = action === "capture" ? at("start").parentElement : at("steps");
  const waits = make("span", { role: "status", class: "state" }, text("starting"));
  place.append(waits);
  at("start").disabled = true;
  try {
    const number = await bench.start(action, { ...asked, ...(isVirtual ? await startVirtual() : {}) });
    goTo((await heard(number, "page")).url, asked.new ?? asked.session);
    at("new-name").value = newName();
  } catch (error) {
    says.textContent = /** @type {Error} */ (error).message;
  }
  waits.remove();
  at("start").disabled = false;
}
session.begin = begin;

/** Go to the page of a guide on this machine, which leads back here. @param {string} url @param {string} name */
function goTo(url, name) {
  if (!isOfThisMachine(url)) return;
  location.hash = `session/${encodeURIComponent(name)}`;
  location.assign(`${url}&back=${encodeURIComponent(`${location.origin}/#session/${encodeURIComponent(name)}`)}`);
}

const newName = () => `${stamp()}-session`;
at("new-name").value = newName();

// What is under way, and what was done

/** @type {Map<number, {banner: any, words: any, newest: any, guide: any}>} by the number of the command */
const banners = new Map();

function showUnderWay() {
  // A virtual instrument is part of its session.
  const running = [...bench.jobs.values()].filter((job) => job.code === null && ![...LOOKS, "emulate"].includes(job.action));
  for (const [number, { banner }] of banners)
    if (!running.some((job) => job.job === number)) {
      banner.remove();
      banners.delete(number);
    }
  for (const job of running) {
    const name = job.values.new ?? job.values.session ?? "";
    const told = Object.values(job.told);
    const counted = told.filter((value) => "accepted" in value && "planned" in value).pop();
    // Changed and not made anew: somebody may be about to press a button of it.
    const { words, newest, guide } = banners.get(job.job) ?? banner(job, name);
    words.textContent = clean(underWay(job, { name, accepted: counted?.accepted, planned: counted?.planned }, Boolean(job.told.page)));
    newest.textContent = job.action === "emulate" ? "" : clean(withSigns(withMarks(told.filter((value) => value.words).pop()?.words ?? "", "named")));
    guide.hidden = !job.told.page;
  }
}

/** Make the banner of a command. @param {import("./bench.js").Job} job @param {string} name */
function banner(job, name) {
  const [words, newest] = [make("strong"), make("span", { class: "state" })];
  const guide = button(text("openGuide"), () => goTo(bench.jobs.get(job.job)?.told.page.url, name), { class: "main" });
  const stop = () => void bench.ask({ cancel: job.job }).catch(refuse);
  const made = {
    banner: make("div", {}, words, newest, guide, sureButton(isGuided(job) ? text("pause") : text("stop"), text("stopSure"), stop)),
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
  if (job.action === "replay") return text("replayed", counts);
  return job.action === "solve" ? text("computing", counts) : job.command;
}

/** A port to which nothing is connected has been looked at, too. @param {import("./bench.js").Job} job */
const isSilent = (job) => job.action === "probe" && job.found[0]?.ports?.[0]?.error?.reason === "silence";

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
            : isSilent(job)
              ? text("heardNothing", { why: complaint(job) })
              : text("notDone", { why: complaint(job) });
    const words = [...job.lines, ...job.said].join("\n");
    const entry = make(
      "li",
      {},
      make("code", {}, job.command),
      " ",
      make("span", { class: job.code && job.code !== 130 && !isSilent(job) ? "failed" : "state" }, state),
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
