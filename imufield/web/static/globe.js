// The positions as points on a sphere: where up is in the body.

import { colour, prepare } from "./canvas.js";
import { apply, product, rotation } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */

const VIEW = product(rotation([1, 0, 0], 0.4), rotation([0, 0, 1], 0.6));
/** A direction as it is seen: to the right, away from the onlooker, up. @param {Vector} direction */
export const seen = (direction) => apply(VIEW, direction);
const POINT = 6;
const FAR = 0.45; // Opacity of what is behind.

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{name: string, up: Vector, state: string}[]} positions
 * @param {Vector | null} up
 */
export function drawGlobe(canvas, positions, up) {
  const { context, width, height } = prepare(canvas);
  const radius = Math.min(width, height) * 0.44;
  /** @param {Vector} direction @returns {[number, number, number]} place, and how far behind */
  const place = (direction) => {
    const [x, depth, z] = seen(direction);
    return [width / 2 + x * radius, height / 2 - z * radius, depth];
  };
  context.strokeStyle = colour("line");
  context.lineWidth = 1;
  context.beginPath();
  context.arc(width / 2, height / 2, radius, 0, 2 * Math.PI);
  for (let axis = 0; axis < 3; axis++) {
    for (let step = 0; step <= 60; step++) {
      const [a, b] = [Math.cos((step / 30) * Math.PI), Math.sin((step / 30) * Math.PI)];
      const [x, y] = place(/** @type {Vector} */ (axis === 0 ? [0, a, b] : axis === 1 ? [a, 0, b] : [a, b, 0]));
      if (step) context.lineTo(x, y);
      else context.moveTo(x, y);
    }
  }
  context.stroke();
  const placed = positions.map((position) => ({ state: position.state, at: place(position.up) })).sort((a, b) => b.at[2] - a.at[2]);
  for (const { state, at } of placed) {
    const [x, y, depth] = at;
    context.globalAlpha = depth > 0.05 ? FAR : 1;
    context.fillStyle = context.strokeStyle = colour(state);
    context.lineWidth = 2;
    context.beginPath();
    // The signs of the list: a shape as well as a colour.
    if (state === "suspect") context.rect(x - POINT, y - POINT, 2 * POINT, 2 * POINT);
    else if (state === "skipped") {
      context.moveTo(x - 5, y - 5);
      context.lineTo(x + 5, y + 5);
      context.moveTo(x + 5, y - 5);
      context.lineTo(x - 5, y + 5);
    } else context.arc(x, y, state === "next" || state === "here" ? POINT + 4 : POINT, 0, 2 * Math.PI);
    if (state === "accepted" || state === "suspect") context.fill();
    else context.stroke();
    if (state !== "next") continue;
    context.beginPath();
    context.arc(x, y, POINT - 1, 0, 2 * Math.PI);
    context.fill();
  }
  context.globalAlpha = 1;
  if (!up) return;
  // A cross of hairs: where the instrument is.
  const [x, y, depth] = place(up);
  context.globalAlpha = depth > 0.05 ? FAR : 1;
  context.strokeStyle = colour("text");
  context.lineWidth = 2.5;
  context.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    context.moveTo(x + 8 * dx, y + 8 * dy);
    context.lineTo(x + 17 * dx, y + 17 * dy);
  }
  context.stroke();
  context.globalAlpha = 1;
}
