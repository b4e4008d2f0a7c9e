// One session: how far it is, its result, and its files.

import { complaint } from "./bench.js";
import { at, button, clean, filled, make, table } from "./make.js";
import { barOf, drawSignals, readOverview } from "./plots.js";
import { signed, text, when, withFields, withSigns } from "./texts.js";

const PARAMETERS = "parameters.toml"; // Its button stands below the verdict, those of other files at the end.
const MICRO_G = 9.80665e-6;
const GRAVITY = 1e6 * MICRO_G;
const DEG_PER_HOUR = (180 / Math.PI) * 3600; // Of a rad/s.
const FEWEST_SOLVED = 6; // Positions, for a result at all.
const FEWEST_CHECKED = 10; // Positions, for a result that is checked: see the pipeline of the program.
const AXES = ["x", "y", "z"];
const LARGEST_ZOOM = 8; // Closer there is nothing more to see in the blocks that the program makes.

/** @typedef {import("./bench.js").Bench} Bench */
/** @typedef {import("./bench.js").Job} Job */

/** A number with its uncertainty, to the digit that this allows. @param {number | null} value @param {number | null} sigma */
function withSigma(value, sigma) {
  if (value === null) return "–";
  if (sigma === null || !(sigma > 0)) return `${value.toPrecision(4)}`;
  const digits = Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(sigma))));
  return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)}`;
}

/**
 * What the folder of a session holds.
 * @typedef {object} Found
 * @property {string[]} files what was made of it
 * @property {string[]} earlier those of them that are older than its parameters, or were replaced
 * @property {any} parameters
 * @property {string} fault of the parameters
 * @property {boolean} is_outdated whether the recording has grown since
 */

/** @type {Found} */
const EMPTY = { files: [], earlier: [], parameters: null, fault: "", is_outdated: false };

export class SessionView {
  /** @param {Bench} bench */
  constructor(bench) {
    this.bench = bench;
    this.name = "";
    /** @type {any} as `sessions` lists it; null where it does not, undefined until that is known */
    this.row = undefined;
    this.found = EMPTY;
    /** @type {Set<string>} */
    this.without = new Set();
    /** @type {(action: string, values: any) => Promise<void>} */
    this.begin = async () => {};
    this.wasUnderWay = false;
    this.refreshed = 0;
    at("report").addEventListener("submit", (/** @type {Event} */ event) => this.report(event));
    at("export").addEventListener("submit", (/** @type {Event} */ event) => this.export(event));
    at("targets").addEventListener("change", () => this.showAsked());
    /** @type {Map<string, Record<string, string>>} what each target asks for, and what it is called there */
    this.asked = new Map();
  }

  /** @param {string} name */
  async open(name) {
    if (name !== this.name) {
      this.row = undefined;
      this.found = EMPTY;
      for (const id of ["result", "made"]) at(id).replaceChildren();
      at("other-place").hidden = true;
    }
    this.name = name;
    at("name").textContent = name;
    at("session-says").textContent = "";
    this.showState();
    await this.refresh();
    this.show();
  }

  /** Show what its folder holds now, whoever made it. @param {boolean} isOther whether its parameters may be others */
  async refresh(isOther = true) {
    const name = this.name;
    const number = ++this.refreshed;
    try {
      const listed = (await this.bench.found("sessions")).sessions;
      const row = listed.find((/** @type {any} */ each) => this.bench.below(each.folder) === name) ?? null;
      const found = row && !row.leads_to ? await this.bench.ask({ session: name }) : EMPTY;
      // What was asked before a file was made may be answered later.
      if (name !== this.name || (number !== this.refreshed && !isOther)) return;
      this.row = row;
      this.found = found;
      this.showState();
      if (isOther) {
        this.without.clear();
        at("result").replaceChildren();
        if (found.parameters) this.showResult(found.parameters);
      }
      if (this.row?.verdict && !at("targets").length) {
        const { targets } = await this.bench.found("targets");
        this.asked = new Map(targets.map((/** @type {any} */ target) => [target.name, target.asks]));
        at("targets").append(
          ...targets.map((/** @type {any} */ target) =>
            make("option", { value: target.name }, `${target.name}: ${target.title} (holds ${target.holds})`),
          ),
        );
      }
    } catch (error) {
      this.refuse(error);
    }
  }

  /** @param {unknown} error */
  refuse(error) {
    at("session-says").textContent = /** @type {Error} */ (error).message;
  }

  /** The commands about this session, of these kinds. @param {string[]} actions */
  jobs(actions) {
    return [...this.bench.jobs.values()].filter(
      ({ action, values }) => actions.includes(action) && (values.new ?? values.session) === this.name,
    );
  }

  /** The command that is about this session and has not ended. */
  underWay() {
    return this.jobs(["capture", "resume", "solve", "import"]).find((job) => job.code === null);
  }

  /** How many positions this page knows of; null where it knows of none. @returns {number | null} */
  positions() {
    const told = this.jobs(["capture", "resume"]).flatMap((job) => job.found.filter((value) => "accepted" in value));
    return told.pop()?.accepted ?? this.row?.positions ?? null;
  }

  /** How many a result needs beside those. */
  missing() {
    return Math.max(0, Math.min(FEWEST_CHECKED, this.row?.planned ?? 0) - (this.positions() ?? Infinity));
  }

  /** Follow what the program says. */
  show() {
    if (!this.name) return;
    const isUnderWay = Boolean(this.underWay());
    if (this.wasUnderWay && !isUnderWay) this.refresh();
    if (this.wasUnderWay !== isUnderWay) this.showState();
    this.wasUnderWay = isUnderWay;
    const reading = this.jobs(["outline", "overview"]).find((job) => job.code === null)?.told.progress;
    const place = document.querySelector("#signals-of-session [role=status]");
    if (reading && place) place.textContent = clean(reading.words);
  }

  showState() {
    const row = this.row;
    const job = this.underWay();
    const [positions, missing] = [this.positions(), this.missing()];
    const toSolve = FEWEST_SOLVED - (positions ?? FEWEST_SOLVED);
    const facts = !row
      ? text(row === null ? "noSession" : "listing")
      : [
          row.instrument,
          row.serial_number,
          when(row.created),
          positions === null ? "" : text("ofPositions", { positions, planned: row.planned ?? positions }),
          row.state,
          row.verdict ? text("verdict", { verdict: row.verdict.toUpperCase() }) : text("notComputed"),
          missing && (toSolve > 0 ? text("tooFew", { missing: toSolve }) : text("missing", { missing })),
        ]
          .filter(Boolean)
          .join(" · ");
    const { files, earlier, parameters, is_outdated: isOutdated } = this.found;
    const fault = (row?.leads_to ? text("leadsOut", row) : "") || this.found.fault || row?.fault;
    at("state").replaceChildren(
      make("p", {}, facts),
      ...[fault, isOutdated && !job ? text("outdated") : ""].filter(Boolean).map((words) => make("p", { class: "failed" }, words)),
    );
    const canSolve = row && row.state !== "damaged" && !row.leads_to && !job;
    const canGoOn = canSolve && row.kind === "capture" && (row.state === "unfinished" || missing);
    at("steps").replaceChildren(
      ...[
        canGoOn ? button(text("goOn"), () => this.resume(), { class: "main" }) : null,
        canSolve ? button(text(row.verdict ? "solveAgain" : "solve"), () => this.solve(), { class: !canGoOn && (!parameters || isOutdated) && "main" }) : null,
        ...(canSolve && row.kind === "capture" ? this.replay() : []),
      ].filter(Boolean),
    );
    at("give").hidden = !parameters;
    at("again").hidden = !canSolve;
    at("again").open = row?.kind === "import" && !row.verdict;
    const isEarlier = (/** @type {string} */ name) => earlier.includes(name);
    const others = files.filter((name) => name !== PARAMETERS && !isEarlier(name));
    at("saved").replaceChildren(...others.map((name) => this.saving(name)));
    at("earlier").hidden = !earlier.length;
    at("saved-earlier").replaceChildren(...files.filter(isEarlier).map((name) => this.saving(name)));
  }

  /** What saves a file of the session. @param {string} name @param {any} [properties] */
  saving(name, properties = {}) {
    return button(text("save", { name }), () => this.save(`${this.name}/${name}`), properties);
  }

  /** What shows the session on the page of the guide again, and how fast. */
  replay() {
    const speed = make("input", { name: "speed", inputmode: "decimal", value: "4", autocomplete: "off" });
    const places = make("label", { class: "speed" }, speed, text("timesAsFast"));
    return [button(text("replay"), () => this.begin("replay", { session: this.name, ...filled(places) })), places];
  }

  /** @param {string} path */
  async save(path) {
    try {
      await this.bench.save(path);
    } catch (error) {
      this.refuse(error);
    }
  }

  /** @param {string[]} retake positions to be measured again */
  async resume(retake = []) {
    const other = filled(at("other-place"));
    const isVirtual = !other.port && this.bench.nameOf(this.row.port ?? "") === this.bench.head.virtual;
    await this.begin("resume", { session: this.name, retake, ...other, isVirtual });
    // Where it was not found, it may be at another port now.
    at("other-place").hidden = !at("session-says").textContent;
  }

  async solve() {
    at("session-says").textContent = "";
    const [name, without] = [this.name, [...this.without]];
    try {
      const job = await this.bench.run("solve", {
        session: name,
        ...filled(at("solve-place")),
        ...(without.length ? { without } : {}),
      });
      if (name !== this.name) return;
      if (job.code !== 0) throw new Error(complaint(job));
      // What the file before knew and this one does not.
      at("session-says").textContent = (job.found[0]?.notes ?? []).join(" ");
    } catch (error) {
      this.refuse(error);
    }
  }

  /** @param {any} found the document that `solve --json` prints */
  showResult(found) {
    const quality = found.quality;
    const holds = found.position;
    this.without = new Set(holds.filter((/** @type {any} */ hold) => !hold.used).map((/** @type {any} */ hold) => hold.name));
    const gained = found.error_at_rest;
    const gyroscope = quality.gyroscope_verdict ?? text("uncalibrated");
    const sizes = holds.map((/** @type {any} */ hold) => Math.abs(hold.leave_one_out_m_s2 ?? hold.residual_m_s2 ?? 0));
    const largest = Math.max(...sizes, 1e-12);
    /** @type {string[]} */
    const doubts = quality.suspects ?? [];
    at("result").replaceChildren(
      make(
        "section",
        { "aria-labelledby": "verdict" },
        make("p", { id: "verdict", class: `verdict ${quality.verdict}` }, quality.verdict.toUpperCase()),
        make("p", {}, text(quality.verdict)),
        make("p", { class: "row" }, this.saving(PARAMETERS, { class: "main" })),
        gained ? make("p", { class: "gain" }, gained.words) : null,
        make("p", {}, text("triads", { accelerometer: quality.accelerometer_verdict, gyroscope })),
        quality.warnings.length
          ? make(
              "ul",
              {},
              quality.warnings.map((/** @type {string} */ words) => make("li", {}, withSigns(withFields(words, "#solve-place")))),
            )
          : null,
        make(
          "details",
          {},
          make("summary", {}, text("reasons")),
          make(
            "ul",
            {},
            quality.reasons
              .filter((/** @type {string} */ words) => !quality.warnings.includes(words))
              .map((/** @type {string} */ words) => make("li", {}, withSigns(words))),
          ),
        ),
      ),
      make(
        "section",
        { "aria-label": text("fits") },
        make("h2", {}, text("fits")),
        make("p", {}, text("fitsHow")),
        make(
          "div",
          { class: "holds" },
          holds.map((/** @type {any} */ hold, /** @type {number} */ k) =>
            this.hold(hold, sizes[k] / largest, doubts.includes(hold.name)),
          ),
        ),
        make(
          "p",
          { class: "row" },
          button(text("solveThese"), () => this.solve()),
          this.row?.kind === "capture" && (doubts.length || holds.length < this.row.planned)
            ? button(doubts.length ? text("retake", { names: withSigns(doubts.join(", ")) }) : text("more"), () => this.resume(doubts))
            : null,
          button(text("signals"), () => void this.showSignals(holds, found.accelerometer.raw_unit)),
        ),
        make("div", { id: "signals-of-session" }),
      ),
      make("section", { "aria-label": text("parameters") }, make("h2", {}, text("parameters")), this.parameters(found)),
    );
  }

  /** @param {any} hold @param {number} share @param {boolean} isDoubtful */
  hold(hold, share, isDoubtful) {
    const [value, name] = [hold.leave_one_out_m_s2 ?? hold.residual_m_s2, withSigns(hold.name)];
    const box = make("input", { type: "checkbox", checked: hold.used, onchange: () => this.keep(hold.name, box.checked) });
    box.dataset.hold = hold.name;
    return make(
      "label",
      { class: isDoubtful ? "doubt" : "" },
      box,
      make("span", {}, isDoubtful ? text("doubtful", { name }) : name),
      barOf(share, !hold.used ? "left" : isDoubtful ? "doubt" : "bar"),
      make("b", {}, value === null ? "–" : signed(value / MICRO_G, 0)),
    );
  }

  /** Keep a position or leave it out, on both pictures. @param {string} name @param {boolean} isKept */
  keep(name, isKept) {
    if (isKept) this.without.delete(name);
    else this.without.add(name);
    for (const box of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("[data-hold]")))
      if (box.dataset.hold === name) box.checked = isKept;
    for (const still of /** @type {NodeListOf<SVGElement>} */ (document.querySelectorAll("[data-still]")))
      if (still.dataset.still === name) {
        still.classList.toggle("left", !isKept);
        still.setAttribute("aria-checked", String(isKept));
      }
  }

  /** Show the signals, of a long recording some seconds first. @param {any[]} holds @param {string} unit of the accelerometer */
  async showSignals(holds, unit) {
    const [place, name, says] = [at("signals-of-session"), this.name, make("p", { role: "status" }, text("reading"))];
    const frame = make("div", { class: "wide" });
    /** @type {Record<string, number[]>} */
    let columns = {};
    let zoom = 1;
    const show = (/** @type {number} */ times) => {
      // What is in the middle stays there.
      const middle = (frame.scrollLeft + frame.clientWidth / 2) / (frame.scrollWidth || 1);
      zoom = Math.max(1, Math.min(LARGEST_ZOOM, zoom * times));
      frame.replaceChildren(drawSignals(columns, holds, this.without, (name) => this.keep(name, this.without.has(name)), { zoom, unit }));
      frame.scrollLeft = middle * frame.scrollWidth - frame.clientWidth / 2;
    };
    const read = async (/** @type {string} */ kind) => {
      columns = readOverview(await (await fetch(await this.bench.address(`${name}/samples.${kind}.csv`))).text());
      if (!frame.isConnected)
        place.prepend(
          make("p", {}, text("signalsHow")),
          make("p", { class: "row" }, button(text("closer"), () => show(2)), button(text("farther"), () => show(1 / 2))),
          frame,
        );
      show(1);
    };
    place.replaceChildren(says);
    try {
      const { signals } = await this.bench.ask({ session: name });
      for (const kind of signals) {
        const job = await this.bench.run(kind, { session: name });
        if (job.code !== 0) throw new Error(complaint(job));
        // Another session may be shown by now.
        if (!says.isConnected) return;
        await read(kind);
      }
      if (!signals.length) await read("overview");
      says.remove();
    } catch (error) {
      says.replaceWith(make("p", { class: "failed" }, /** @type {Error} */ (error).message));
    }
  }

  /** @param {any} found */
  parameters(found) {
    /** @type {any[][]} */
    const rows = [];
    const of = (
      /** @type {string} */ name,
      /** @type {string} */ unit,
      /** @type {any} */ triad,
      /** @type {string} */ key,
      /** @type {number | number[]} */ factor,
      /** @type {number} */ less,
    ) => {
      const sigma = triad.uncertainty[key];
      const factors = Array.isArray(factor) ? factor : AXES.map(() => factor);
      rows.push([
        name,
        unit,
        ...AXES.map((_, k) =>
          withSigma(
            triad[key][k] === null ? null : (triad[key][k] - less) * factors[k],
            sigma[k] === null ? null : sigma[k] * Math.abs(factors[k]),
          ),
        ),
      ]);
    };
    const acc = found.accelerometer;
    of(text("bias"), "mg", acc, "bias_m_s2", 1e-3 / MICRO_G, 0);
    if (acc.raw_unit === "m/s^2") of(text("scaleError"), "ppm", acc, "scale", 1e6, 1);
    else of(text("scale"), text("perUnit", { unit: acc.raw_unit }), acc, "scale", 1, 0);
    const gyro = found.gyroscope;
    if (gyro) {
      of(text("gyroBias"), "deg/h", gyro, "bias_rad_s", DEG_PER_HOUR, 0);
      if (gyro.raw_unit === "rad/s") of(text("gyroScale"), "ppm", gyro, "scale", 1e6, 1);
      else of(text("gyroScaleOf"), text("perRate", { unit: gyro.raw_unit }), gyro, "scale", 1, 0);
    }
    for (const [name, triad] of [
      [text("angles"), acc],
      [text("gyroAngles"), gyro],
    ])
      if (triad) rows.push(...this.entries(name, "mrad", triad.misalignment_rad, triad.uncertainty.misalignment_rad, [1e3, 1e3, 1e3]));
    const micro = acc.scale.map((/** @type {number} */ scale) => (1e6 * GRAVITY) / scale);
    if (acc.quadratic_fitted) of(text("quadratic"), "µg/g²", acc, "quadratic", micro, 0);
    if (acc.higher) {
      const terms = { ...acc.higher, uncertainty: { cubic: acc.higher.cubic_sigma } };
      of(text("cubic"), "µg/g³", terms, "cubic", 1e6 * GRAVITY ** 2, 0);
      for (const [k, axes] of ["xy", "xz", "yz"].entries()) {
        const cross = { cross: acc.higher.cross[k], uncertainty: { cross: acc.higher.cross_sigma[k] } };
        of(text("cross", { axes }), "µg/g²", cross, "cross", 1e6 * GRAVITY, 0);
      }
    }
    if (gyro) {
      const perG = gyro.scale.map((/** @type {number} */ scale) => (DEG_PER_HOUR * GRAVITY) / scale);
      rows.push(...this.entries(text("sensitivity"), "deg/h/g", gyro.g_sensitivity, gyro.uncertainty.g_sensitivity, perG));
    }
    return table(text("parametersHead").split(", "), rows, "stacks");
  }

  /**
   * Rows of the entries of a matrix that were fitted, each below the sensing axis that it is of.
   * @param {string} name @param {string} unit @param {number[][]} values @param {(number | null)[][]} sigmas
   * @param {number[]} factors of each axis
   */
  entries(name, unit, values, sigmas, factors) {
    const columns = AXES.map((axis, i) =>
      AXES.flatMap((towards, j) => {
        const sigma = (sigmas[i][j] ?? 0) * Math.abs(factors[i]);
        return sigma > 0 ? `${axis}${towards} ${withSigma(values[i][j] * factors[i], sigma)}` : [];
      }),
    );
    const high = Math.max(...columns.map((column) => column.length));
    return Array.from({ length: high }, (_, k) => [name, unit, ...columns.map((column) => column[k] ?? "")]);
  }

  /** @param {Event} event */
  async report(event) {
    event.preventDefault();
    await this.made("report", { session: this.name, ...filled(at("report")) });
  }

  /** Ask for what the chosen program needs beside the parameters. */
  showAsked() {
    at("asked").replaceChildren(
      ...Object.entries(this.asked.get(at("targets").value) ?? {}).map(([name, value]) =>
        make("label", {}, text("asked", { name, value }), make("input", { "data-asked": name, inputmode: "numeric", autocomplete: "off" })),
      ),
    );
  }

  /** @param {Event} event */
  async export(event) {
    event.preventDefault();
    const { to, settings = "" } = filled(at("export"));
    const asked = [.../** @type {NodeListOf<HTMLInputElement>} */ (at("asked").querySelectorAll("input"))]
      .filter((field) => field.value.trim())
      .map((field) => `${field.dataset.asked}=${field.value.trim()}`);
    // As the page names them, or as they are typed in a terminal.
    const typed = [...asked, ...settings.split(/(?:[\s,;]|--set\b=?)+/).filter(Boolean)];
    await this.made("export", { session: this.name, to, ...(typed.length ? { settings: typed } : {}) });
  }

  /** Run a command that makes files, and show them, and what they lack. @param {string} action @param {any} values */
  async made(action, values) {
    at("made").replaceChildren(make("p", {}, text("working")));
    try {
      const job = await this.bench.run(action, values);
      if (job.code !== 0) throw new Error(complaint(job));
      // A command that prints no value says in lines what it made.
      const { files, losses, notes } = job.found[0] ?? { notes: job.lines };
      at("made").replaceChildren(
        files ? make("p", {}, text("made", { names: files.map((/** @type {string} */ path) => this.bench.nameOf(path)).join(", ") })) : "",
        make(
          "ul",
          {},
          (losses ?? []).map((/** @type {string} */ words) => make("li", {}, text("lost", { words }))),
          (notes ?? []).map((/** @type {string} */ words) => make("li", {}, words)),
        ),
      );
      await this.refresh(false);
    } catch (error) {
      at("made").replaceChildren(make("p", { class: "failed" }, /** @type {Error} */ (error).message));
    }
  }
}
