// Files that are dropped on the page: sent up, imported, and asked about where they do not say what their columns are.

import { complaint } from "./bench.js";
import { at, button, filled, make, stamp, table } from "./make.js";
import { lineOf } from "./plots.js";
import { text } from "./texts.js";

const SHOWN_ROWS = 6;
const READ_BYTES = 200000;
const MEANINGS = ["-", "time", "ax", "ay", "az", "gx", "gy", "gz", "temperature"];
const UNITS = {
  accelerometer_unit: ["m/s^2", "g", "count"],
  gyroscope_unit: ["rad/s", "deg/s", "count"],
  time_unit: ["s", "ms", "us", "ns"],
};

/** @typedef {import("./bench.js").Bench} Bench */

/** @param {Bench} bench */
export function watchDrop(bench) {
  const drop = at("drop");
  const take = (/** @type {FileList | null | undefined} */ files) => {
    if (files?.length) void bring(bench, [...files]);
  };
  // Anywhere on the page: a browser would open the file in its place.
  for (const kind of ["dragover", "dragleave", "drop"])
    addEventListener(kind, (/** @type {any} */ event) => {
      event.preventDefault();
      drop.classList.toggle("over", kind === "dragover");
      if (kind !== "drop") return;
      location.hash = "import";
      take(event.dataTransfer?.files);
    });
  at("files").addEventListener("change", (/** @type {any} */ event) => take(event.target.files));
}

/** @param {string} words */
const say = (words) => (at("import-says").textContent = words);

/** @param {Bench} bench @param {File[]} files */
async function bring(bench, files) {
  at("import-more").replaceChildren();
  /** @type {string[]} */
  const paths = [];
  try {
    let folder = null;
    for (const file of files) {
      const sent = await bench.upload(file, folder, (share) =>
        say(text("sent", { name: file.name, share: Math.round(100 * share) })),
      );
      folder = sent.folder;
      paths.push(sent.file);
    }
    say("");
  } catch (error) {
    say(/** @type {Error} */ (error).message);
    return;
  }
  const stem =
    files[0].name
      .replace(/\..*$/, "")
      .replace(/[^A-Za-z0-9_-]+/g, "-")
      .replace(/^[-_]+/, "") || "recording";
  // One form for all attempts: what was typed stays.
  const form = await asking(bench, files, (values) => void tryImport(values));
  await tryImport({});

  /** @param {any} typed */
  async function tryImport(typed) {
    say("");
    at("import-more").replaceChildren(make("section", {}, make("p", { role: "status" }, text("importing"))));
    const name = `${stem.slice(0, 60)}-${stamp()}`;
    try {
      const job = await bench.run("import", { files: paths, new: name, ...typed });
      if (job.code === 0) {
        at("import-more").replaceChildren(
          make(
            "section",
            {},
            make("h2", {}, text("imported")),
            make(
              "ul",
              {},
              job.found[0].assumptions.map((/** @type {string} */ words) => make("li", {}, words)),
            ),
            make(
              "p",
              { class: "row" },
              button(text("toResult"), () => (location.hash = `session/${encodeURIComponent(name)}`), { class: "main" }),
            ),
            make("details", {}, make("summary", {}, text("wrong")), form),
          ),
        );
      } else {
        // Where it is kept here says nothing to whoever dropped it.
        say(paths.reduce((words, path) => words.replaceAll(`${bench.head.root}/${path}`, bench.nameOf(path)), complaint(job)));
        at("import-more").replaceChildren(make("section", {}, make("h2", {}, text("what")), form));
      }
    } catch (error) {
      say(/** @type {Error} */ (error).message);
      at("import-more").replaceChildren();
    }
  }
}

const unitFields = () => [
  ...Object.entries(UNITS).map(([name, units]) =>
    choice(
      text("unit", { quantity: name.replace("_", ", "), name }),
      { "data-unit": name },
      units.map((unit) => make("option", {}, unit)),
    ),
  ),
  make("label", {}, text("rate"), make("input", { name: "rate_hz", inputmode: "decimal", autocomplete: "off" })),
  make("label", {}, text("zero"), make("input", { name: "zero", autocomplete: "off" })),
];

/** @param {Bench} bench */
async function instrumentField(bench) {
  const { drivers } = await bench.found("devices").catch(() => ({ drivers: [] }));
  return choice(
    text("whose"),
    { name: "driver" },
    drivers.map((/** @type {any} */ driver) => make("option", { value: driver.name }, `${driver.title} (${driver.name})`)),
  );
}

/** @param {string} words @param {any} properties @param {any[]} options behind what the program finds */
const choice = (words, properties, options) =>
  make("label", {}, words, make("select", properties, make("option", { value: "" }, text("asFound")), options));

/** The first rows of a table: what stands in its lines, split at commas, semicolons or blanks. @param {File} file */
async function rowsOf(file) {
  let head = file.slice(0, READ_BYTES);
  if (file.name.endsWith(".gz")) {
    try {
      const reader = file.stream().pipeThrough(new DecompressionStream("gzip")).getReader();
      head = new Blob([(await reader.read()).value ?? new Uint8Array()]).slice(0, READ_BYTES);
      await reader.cancel();
    } catch {
      return [];
    }
  }
  const text = await head.text();
  if (/[\u0000\ufffd]/.test(text.slice(0, 2000))) return [];
  const lines = text
    .split(/\r?\n/)
    .slice(0, -1)
    .filter((line) => line.trim());
  const separator = [",", ";", "\t"].find((each) => lines[lines.length - 1]?.includes(each)) ?? /\s+/;
  return lines.map((line) =>
    line
      .trim()
      .split(separator)
      .map((cell) => cell.trim()),
  );
}

/**
 * A form that asks what the program does not know: of tables, with the first rows and the signals beside it, of all else
 * whose bytes or frames they are.
 * @param {Bench} bench @param {File[]} files @param {(values: any) => void} onAnswer
 */
async function asking(bench, files, onAnswer) {
  /** @type {{file: File, head: string[], choices: any[], element: any}[]} */
  const tables = [];
  for (const file of files) {
    const rows = await rowsOf(file);
    const isNumber = (/** @type {string[]} */ row) => row.every((cell) => cell === "" || Number.isFinite(Number(cell)));
    const numbers = rows.filter((row) => isNumber(row) && row.length === rows[rows.length - 1].length);
    if (numbers.length < 2) continue;
    const width = numbers[0].length;
    const choices = Array.from({ length: width }, (_, k) =>
      make(
        "select",
        { "aria-label": text("meaning", { number: k + 1 }), "data-column": k },
        make("option", { value: "" }, text("asFound")),
        MEANINGS.map((name) => make("option", { value: name }, name === "-" ? text("leaveOut") : name)),
      ),
    );
    const signals = Array.from({ length: width }, (_, k) => {
      const column = numbers.filter((row) => row[k]).map((row) => Number(row[k]));
      const [low, high] = [Math.min(...column), Math.max(...column)].map((value) => Number(value.toPrecision(4)));
      return make("div", {}, lineOf(column, "small"), make("small", {}, column.length ? text("between", { low, high }) : ""));
    });
    const head = rows.find((row) => !isNumber(row) && row.length === width) ?? [];
    tables.push({
      file,
      head,
      choices,
      element: table(
        Array.from({ length: width }, (_, k) => head[k] ?? text("column", { number: k + 1 })),
        [choices, signals, ...numbers.slice(0, SHOWN_ROWS)],
      ),
    });
  }
  const form = make(
    "form",
    { class: "fields" },
    tables.length ? unitFields() : await instrumentField(bench),
    make("button", { type: "submit", class: "main" }, text("importThese")),
  );
  form.addEventListener("submit", (/** @type {Event} */ event) => {
    event.preventDefault();
    const isNamed = tables.some(({ choices }) => choices.some((choice) => choice.value));
    // The program takes all names of a file or none: those that its heading has stand where none was chosen.
    const columns = tables.map(({ choices, head }) =>
      choices.map((choice, k) => choice.value || (MEANINGS.includes(head[k]) ? head[k] : "-")).join(","),
    );
    const settings = [.../** @type {NodeListOf<HTMLSelectElement>} */ (form.querySelectorAll("[data-unit]"))]
      .filter((field) => field.value)
      .map((field) => `${field.dataset.unit}=${field.value}`);
    onAnswer({
      ...filled(form),
      ...(isNamed ? { columns: columns.join(";") } : {}),
      ...(settings.length ? { settings } : {}),
    });
  });
  return make(
    "div",
    {},
    tables.map(({ file, element }) => make("div", {}, make("h3", {}, file.name), element)),
    form,
  );
}
