// The positions as points on a sphere: where up is in the body.

import { apply, product, rotation } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */

const VIEW = product(rotation([1, 0, 0], 0.4), rotation([0, 0, 1], 0.6));

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{name: string, up: Vector, state: string}[]} positions
 * @param {Vector | null} up
 */
export function drawGlobe(canvas, positions, up) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(ratio, ratio);
  const style = getComputedStyle(document.documentElement);
  /** @param {string} name */
  const colour = (name) => style.getPropertyValue(name).trim();
  const radius = Math.min(width, height) * 0.42;
  const [x0, y0] = [width / 2, height / 2];
  context.strokeStyle = colour("--line");
  context.beginPath();
  context.arc(x0, y0, radius, 0, 2 * Math.PI);
  context.stroke();
  for (let axis = 0; axis < 3; axis++) {
    context.beginPath();
    for (let step = 0; step <= 60; step++) {
      const [a, b] = [Math.cos((step / 30) * Math.PI), Math.sin((step / 30) * Math.PI)];
      const seen = apply(VIEW, /** @type {Vector} */ (axis === 0 ? [0, a, b] : axis === 1 ? [a, 0, b] : [a, b, 0]));
      context.lineTo(x0 + seen[0] * radius, y0 - seen[2] * radius);
    }
    context.globalAlpha = 0.35;
    context.stroke();
    context.globalAlpha = 1;
  }
  const seen = positions.map((position) => ({ position, at: apply(VIEW, position.up) })).sort((a, b) => b.at[1] - a.at[1]);
  for (const { position, at } of seen) {
    context.globalAlpha = at[1] > 0.05 ? 0.4 : 1;
    const [x, y] = [x0 + at[0] * radius, y0 - at[2] * radius];
    context.fillStyle = context.strokeStyle = colour(`--${position.state}`);
    context.lineWidth = 2;
    context.beginPath();
    // Shape as well as colour: a ring is open, a disc is done, a square is a suspect, a cross is skipped.
    if (position.state === "suspect") context.rect(x - 5, y - 5, 10, 10);
    else if (position.state === "skipped") {
      context.moveTo(x - 4, y - 4);
      context.lineTo(x + 4, y + 4);
      context.moveTo(x + 4, y - 4);
      context.lineTo(x - 4, y + 4);
    } else context.arc(x, y, position.state === "next" ? 7 : 5, 0, 2 * Math.PI);
    if (position.state === "open" || position.state === "skipped") context.stroke();
    else context.fill();
  }
  context.globalAlpha = 1;
  if (up) {
    const at = apply(VIEW, up);
    context.strokeStyle = colour("--text");
    context.lineWidth = 2;
    context.beginPath();
    context.arc(x0 + at[0] * radius, y0 - at[2] * radius, 9, 0, 2 * Math.PI);
    context.stroke();
  }
}
