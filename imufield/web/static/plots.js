// Plots: a bar for each position, and the signals of a recording with its still intervals.

import { draw, make } from "./make.js";
import { text, withSigns } from "./texts.js";

const WIDTH = 1000;
const HEIGHT = 260;
const EDGE = 30; // Half of the longest time that is written below.
const AXES = ["x", "y", "z"];

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
 * Read what `export-data --to overview` writes.
 * @param {string} text
 * @returns {Record<string, number[]>} columns by name
 */
export function readOverview(text) {
  const [names, ...rows] = text
    .trimEnd()
    .split("\n")
    .map((line) => line.split(","));
  return Object.fromEntries(names.map((name, k) => [name, rows.map((row) => (row[k] ? Number(row[k]) : NaN))]));
}

/** Round values between two, so many times two to five of them. @param {number} low @param {number} high @param {number} [many] */
function ticks(low, high, many = 1) {
  const span = (high - low) / many;
  const power = 10 ** Math.floor(Math.log10(span / 2 || 1));
  const step = ([5, 2].find((times) => span / (times * power) >= 2) ?? 1) * power;
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(6)));
}

/**
 * @param {Record<string, number[]>} columns
 * @param {any[]} holds
 * @param {Set<string>} without
 * @param {(name: string) => void} onChoose
 * @param {{zoom: number, unit: string}} look how many times as wide as the page, and the unit of the accelerometer
 */
export function drawSignals(columns, holds, without, onChoose, { zoom, unit }) {
  const time = columns.time_s;
  const values = AXES.flatMap((axis) => [...columns[`a${axis}_min`], ...columns[`a${axis}_max`]]).filter(Number.isFinite);
  if (!values.length) return make("p", {}, text("noSamples"));
  const [first, last, wide] = [time[0], time[time.length - 1], WIDTH * zoom];
  const low = values.reduce((a, b) => Math.min(a, b));
  const high = values.reduce((a, b) => Math.max(a, b));
  const x = (/** @type {number} */ at) => (wide * (at - first)) / (last - first || 1);
  const y = (/** @type {number} */ value) => HEIGHT - 20 - ((HEIGHT - 25) * (value - low)) / (high - low || 1);
  const pointsOf = (/** @type {string} */ name) =>
    columns[name].map((value, k) => (Number.isFinite(value) ? `${x(time[k]).toFixed(1)},${y(value).toFixed(1)}` : "")).filter(Boolean);
  const lines = AXES.flatMap((axis) => [
    draw("polygon", { class: axis, points: [...pointsOf(`a${axis}_max`), ...pointsOf(`a${axis}_min`).reverse()].join(" ") }),
    draw("polyline", { class: axis, points: pointsOf(`a${axis}_mean`).join(" ") }),
  ]);
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
          "aria-label": withSigns(hold.name),
          "data-still": hold.name,
          onclick: choose,
          onkeydown: choose,
        },
        draw("title", {}, withSigns(hold.name)),
      );
    });
  const words = ticks(0, last - first, 2 * zoom).map((seconds) => {
    const across = x(first + seconds);
    const anchor = across < EDGE ? "start" : across > wide - EDGE ? "end" : "middle";
    return draw("text", { x: across, y: HEIGHT - 4, "text-anchor": anchor }, `${seconds} s`);
  });
  const heights = ticks(low, high);
  const levels = heights.map((value) => draw("line", { class: "level", x1: 0, x2: wide, y1: y(value), y2: y(value) }));
  // Where a part is shown, each has them in sight.
  const names = heights.flatMap((value) =>
    Array.from({ length: zoom }, (_, k) => draw("text", { x: WIDTH * k + 4, y: y(value) - 3 }, `${value} ${withSigns(unit)}`)),
  );
  const drawn = draw(
    "svg",
    { viewBox: `0 0 ${wide} ${HEIGHT}`, class: "plot", role: "group", "aria-label": text("plot") },
    levels,
    lines,
    stills,
    words,
    // Above the lines: a number that is crossed out is none.
    names,
  );
  drawn.style.width = `${100 * zoom}%`;
  drawn.style.minWidth = `${44 * zoom}rem`;
  return drawn;
}
