// The sessions of the folder, and the history of each instrument.

import { complaint } from "./bench.js";
import { at, button, make, table } from "./make.js";
import { text, when } from "./texts.js";

/** @typedef {import("./bench.js").Bench} Bench */
/** @typedef {import("./bench.js").Job} Job */

/** @param {Bench} bench @param {Job} job */
export function showSessions(bench, job) {
  const rows = (job.found[0]?.sessions ?? []).map((/** @type {any} */ row) => {
    const name = bench.below(row.folder);
    return [
      row.leads_to ? name : make("a", { href: `#session/${encodeURIComponent(name)}` }, name),
      when(row.created),
      [row.instrument, row.serial_number].filter(Boolean).join(" "),
      row.positions !== null && row.planned !== null ? text("ofPlanned", row) : row.positions,
      row.leads_to ? text("leadsOut", row) : (row.fault ?? row.state),
      make("strong", { class: row.verdict ?? "" }, row.verdict?.toUpperCase() ?? text("unsolved")),
    ];
  });
  at("list").replaceChildren(rows.length ? table(text("sessionsHead").split(", "), rows, "stacks") : make("p", {}, job.code === 0 ? text("noSessions") : complaint(job)));
}

/** @param {Bench} bench @param {Job} job */
export function showHistory(bench, job) {
  const instruments = job.found[0]?.instruments ?? [];
  at("instruments").replaceChildren(
    ...(instruments.length ? [] : [make("p", {}, text("noHistory")), job.code === 0 ? "" : make("p", { class: "state" }, complaint(job))]),
    ...instruments.map((/** @type {any} */ instrument) => {
      const plot = make("div", { class: "wide" });
      const serial = instrument.serial_number ? { serial_number: instrument.serial_number } : {};
      const calibrations = instrument.calibrations.map((/** @type {any} */ each) => [
        each.created.slice(0, 10),
        make("strong", { class: each.verdict }, each.verdict.toUpperCase()),
        each.file,
        ...["bias x", "bias y", "bias z"].map((name) => {
          const number = each.parameters[name];
          return number ? `${number.value.toFixed(2)} ± ${number.sigma.toFixed(2)} ${number.unit}` : "";
        }),
      ]);
      return make(
        "article",
        {},
        make("h3", {}, `${instrument.instrument} ${instrument.serial_number ?? ""}`),
        table(text("historyHead").split(", "), calibrations, "stacks"),
        make(
          "ul",
          {},
          instrument.sentences.map((/** @type {string} */ words) => make("li", {}, words)),
        ),
        // Of one alone there is no change.
        calibrations.length < 2 ? null : button(text("draw"), async () => {
          try {
            const drawn = await bench.run("history", { ...serial, plot: true });
            if (drawn.code !== 0) throw new Error(complaint(drawn));
            plot.replaceChildren(
              make("img", { src: await bench.address("history.svg"), alt: text("drawn", { name: instrument.instrument }) }),
            );
          } catch (error) {
            plot.replaceChildren(make("p", { class: "failed" }, /** @type {Error} */ (error).message));
          }
        }),
        plot,
      );
    }),
  );
}
