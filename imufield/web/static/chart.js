// Strips with a line each: the newest signals (as long as `trace_s` of the head: guide_page.py), and the accuracy.

import { colour, prepare } from "./canvas.js";
import { signed, text } from "./texts.js";

const AXES = "xyz";
const UNITS = ["m/s²", "°/s", "°C"];
const FORECAST_UNITS = ["µg", "ppm", "µrad"];
const LEAST = [0.5, 2, 0.5]; // Of each unit: what is smaller is noise.
const LABEL = 92; // Least width of the names.
const ENDS = 40; // Least width of the numbers beside a line.
const GAP = 8; // Behind either.
const EDGE = 10;
const NAMES = "13px system-ui, sans-serif";
const NUMBERS = "11px system-ui, sans-serif";
const AXIS = 18; // Below all strips.

/** @typedef {[number, number][]} Points share of the width and of the height */

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{name: string, value: string, ink: string, points: Points, ends: [string, string], dots?: boolean}[]} strips
 *   each with its lowest and highest value
 * @param {[string, string]} across what begins and ends the axis below them
 */
function drawStrips(canvas, strips, across) {
  const { context, width, height } = prepare(canvas);
  const strip = (height - AXIS) / strips.length;
  /** Width of a column of words; more than the least is rare, so that it hardly changes. @param {string[]} words @param {number} least */
  const column = (words, least) => Math.max(least, ...words.map((each) => context.measureText(each).width + GAP));
  context.font = NAMES;
  const label = column(strips.flatMap(({ name, value }) => [name, value]), LABEL);
  context.font = NUMBERS;
  const left = label + column(strips.flatMap(({ ends }) => ends), ENDS);
  context.textBaseline = "middle";
  context.fillStyle = colour("faint");
  context.fillText(across[0], left, height - AXIS / 2);
  context.textAlign = "right";
  context.fillText(across[1], width, height - AXIS / 2);
  context.textAlign = "left";
  strips.forEach(({ name, value, ink, points, ends, dots }, row) => {
    const [top, middle] = [strip * row, strip * (row + 0.5)];
    context.font = NAMES;
    context.fillStyle = colour("faint");
    context.fillText(name, 0, middle - 8);
    context.fillStyle = colour("text");
    context.fillText(value, 0, middle + 8);
    context.strokeStyle = colour("line");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(left, top + strip - 0.5);
    context.lineTo(width, top + strip - 0.5);
    context.stroke();
    context.strokeStyle = colour(ink);
    context.lineWidth = 2;
    context.lineJoin = "round";
    context.beginPath();
    let isDown = false;
    for (const [across, up] of points) {
      const [x, y] = [left + across * (width - left - EDGE), top + strip * (0.9 - 0.8 * up)];
      if (!Number.isFinite(y)) isDown = false;
      else if (isDown) context.lineTo(x, y);
      else {
        context.moveTo(x, y);
        isDown = true;
      }
    }
    context.stroke();
    context.font = NUMBERS;
    context.fillStyle = colour("faint");
    context.textAlign = "right";
    ends.forEach((words, k) => context.fillText(words, left - GAP, top + strip * (k ? 0.2 : 0.8)));
    context.textAlign = "left";
    context.fillStyle = colour(ink);
    const last = points[points.length - 1];
    if (!dots || !last) return;
    context.beginPath();
    context.arc(left + last[0] * (width - left - EDGE), top + strip * (0.9 - 0.8 * last[1]), 4, 0, 2 * Math.PI);
    context.fill();
  });
}

/**
 * Lowest and highest value of a strip in words.
 * @param {number} low @param {number} high @param {(value: number) => string} words @returns {[string, string]}
 */
const endsOf = (low, high, words) => [words(low), words(high)];

/**
 * @param {HTMLCanvasElement} canvas
 * @param {(number | null)[][]} blocks time, six values and the temperature, SI and °C
 * @param {number} spanS that is shown
 */
export function drawTrace(canvas, blocks, spanS) {
  const newest = Number(blocks[blocks.length - 1]?.[0]);
  const shown = blocks.filter((block) => newest - Number(block[0]) <= spanS);
  const columns = [1, 2, 3, 4, 5, 6, 7].filter((k) => shown.some((block) => typeof block[k] === "number"));
  if (!columns.length) return;
  drawStrips(
    canvas,
    columns.map((k) => {
      const unit = Math.floor((k - 1) / 3);
      const values = shown.map((block) => (typeof block[k] === "number" ? Number(block[k]) * (unit === 1 ? 180 / Math.PI : 1) : NaN));
      const known = values.filter(Number.isFinite);
      const [low, high] = [Math.min(...known), Math.max(...known)];
      const half = Math.max(high - low, LEAST[unit]) / 2;
      const points = values.map((value, index) => {
        const across = 1 - (newest - Number(shown[index][0])) / spanS;
        return /** @type {[number, number]} */ ([across, 0.5 + (value - (low + high) / 2) / half / 2]);
      });
      const last = values[values.length - 1] ?? NaN;
      const digits = half < 5 ? 2 : 0;
      return {
        ends: endsOf(-half, half, (side) => signed((low + high) / 2 + side, digits)),
        name: text(["acc", "gyro", "temperature"][unit], { axis: AXES[(k - 1) % 3] }),
        value: Number.isFinite(last) ? `${last.toFixed(2).replace(/^-0.00$/, "0.00").replace("-", "−")} ${UNITS[unit]}` : "–",
        ink: unit < 2 ? `signal-${AXES[(k - 1) % 3]}` : "text",
        points,
      };
    }),
    [text("ago", { seconds: spanS }), text("now")],
  );
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {(number | null)[][]} forecasts number of positions done, and three values
 * @param {number} planned
 * @param {string[]} words of the newest values
 */
export function drawForecast(canvas, forecasts, planned, words) {
  const names = [text("bias"), text("scale"), text("angles")];
  drawStrips(
    canvas,
    names.map((name, k) => {
      const logs = forecasts.map((entry) => (typeof entry[k + 1] === "number" ? Math.log(Number(entry[k + 1])) : NaN));
      const known = logs.filter(Number.isFinite);
      const [low, high] = [Math.min(...known), Math.max(...known)];
      const points = forecasts
        .map((entry, index) => /** @type {[number, number]} */ ([Number(entry[0]) / planned, (logs[index] - low) / (high - low || 1)]))
        .filter(([, up]) => Number.isFinite(up));
      const ends = endsOf(low, high, (log) => (known.length ? `${Number(Math.exp(log).toPrecision(2))} ${FORECAST_UNITS[k]}` : ""));
      return { name, value: words[k] ?? "–", ink: "next", points, ends, dots: true };
    }),
    [text("counted", { count: 0 }), text("counted", { count: planned })],
  );
}
