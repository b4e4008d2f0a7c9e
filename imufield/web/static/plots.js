// Plots: a bar for each position, and the signals of a recording with its still intervals.

import { draw, make } from "./make.js";
import { text } from "./texts.js";

const WIDTH = 1000;
const HEIGHT = 260;
const POINTS = 1500; // A screen shows no more.

/** @param {number} share of the largest @param {string} kind */
export const barOf = (share, kind) =>
  draw(
    "svg",
    { viewBox: "0 0 100 10", preserveAspectRatio: "none", class: "plot", "aria-hidden": "true" },
    draw("rect", { class: kind, x: 0, y: 0, height: 10, width: Math.max(0.5, 100 * share) }),
  );

/** A line through values, as high as they reach. @param {number[]} values @param {string} kind */
export function lineOf(values, kind) {
  const known = values.filter(Number.isFinite);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const points = values.map(
    (value, k) => `${((100 * k) / values.length).toFixed(1)},${(28 - (26 * (value - low)) / (high - low || 1)).toFixed(1)}`,
  );
  return draw(
    "svg",
    { viewBox: "0 0 100 30", preserveAspectRatio: "none", class: `plot ${kind}`, "aria-hidden": "true" },
    draw("polyline", { points: points.join(" ") }),
  );
}

/**
 * Read what `export-data` writes: time and the accelerometer, some thousand means of neighbours.
 * @param {string} text
 * @returns {number[][]} rows of time and three axes
 */
export function readSamples(text) {
  const lines = text.split("\n");
  const names = lines[0].split(",");
  const wanted = ["time_s", "ax", "ay", "az"].map((name) => names.indexOf(name));
  const step = Math.max(1, Math.ceil((lines.length - 1) / POINTS));
  const rows = [];
  for (let start = 1; start + step <= lines.length; start += step) {
    const sums = [0, 0, 0, 0];
    let count = 0;
    for (let k = start; k < start + step; k++) {
      const cells = lines[k].split(",");
      const values = wanted.map((place) => (cells[place] ? Number(cells[place]) : NaN));
      if (!values.every(Number.isFinite)) continue;
      values.forEach((value, axis) => (sums[axis] += value));
      count += 1;
    }
    if (count) rows.push(sums.map((sum) => sum / count));
  }
  return rows;
}

/**
 * @param {number[][]} samples
 * @param {any[]} holds
 * @param {Set<string>} without
 * @param {(name: string) => void} onChoose
 */
export function drawSignals(samples, holds, without, onChoose) {
  if (!samples.length) return make("p", {}, text("noSamples"));
  const [first, last] = [samples[0][0], samples[samples.length - 1][0]];
  const values = samples.flatMap((row) => row.slice(1));
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const x = (/** @type {number} */ time) => (WIDTH * (time - first)) / (last - first || 1);
  const y = (/** @type {number} */ value) => HEIGHT - 20 - ((HEIGHT - 25) * (value - low)) / (high - low || 1);
  const lines = ["x", "y", "z"].map((axis, k) =>
    draw("polyline", {
      class: axis,
      points: samples.map((row) => `${x(row[0]).toFixed(1)},${y(row[k + 1]).toFixed(1)}`).join(" "),
    }),
  );
  const stills = holds
    .filter((hold) => hold.start_s !== null)
    .map((hold) => {
      const isKept = !without.has(hold.name);
      const choose = (/** @type {any} */ event) => {
        if (event.type === "keydown" && event.key !== " " && event.key !== "Enter") return;
        event.preventDefault();
        onChoose(hold.name);
      };
      return draw(
        "rect",
        {
          class: isKept ? "still" : "still left",
          x: x(hold.start_s),
          y: 0,
          height: HEIGHT - 18,
          width: Math.max(2, x(hold.start_s + hold.duration_s) - x(hold.start_s)),
          tabindex: 0,
          role: "checkbox",
          "aria-checked": String(isKept),
          "aria-label": hold.name,
          "data-still": hold.name,
          onclick: choose,
          onkeydown: choose,
        },
        draw("title", {}, hold.name),
      );
    });
  const words = [
    draw("text", { x: 2, y: HEIGHT - 4 }, "0 s"),
    draw("text", { x: WIDTH - 2, y: HEIGHT - 4, "text-anchor": "end" }, `${(last - first).toFixed(0)} s`),
  ];
  return draw(
    "svg",
    { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plot", role: "group", "aria-label": text("plot") },
    lines,
    stills,
    words,
  );
}
