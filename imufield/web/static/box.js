// The instrument as a box with named faces, a cable and light from above, and the turn that brings it where it should be.

import { UNTURNED, apply, dot, orthonormal, product, rotation, smallestTurn } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {import("./vectors.js").Matrix} Matrix */

/** @type {Vector} */
const HALF = [1, 0.72, 0.42];
const AXES = "xyz";
/** @type {Vector} */
const UP = [0, 0, 1];
// The onlooker looks a little from above and from one side: three faces are seen in almost every attitude.
const ONLOOKER = product(rotation([1, 0, 0], (24 * Math.PI) / 180), rotation([0, 0, 1], (33 * Math.PI) / 180));
/** @type {Vector} */
const LIGHT = [-0.35, -0.6, 0.72];
const CABLE = 0.8;
const REACH = 1.75;
const FOLLOW_MS = 60; // The box is where the newest sample says after about two frames.

/** @returns {string[]} the colours of the style sheet */
const colours = () => {
  const style = getComputedStyle(document.documentElement);
  return ["--box", "--goal", "--text", "--arrow"].map((name) => style.getPropertyValue(name).trim());
};

export class Box {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    /** @type {Matrix} */
    this.attitude = UNTURNED;
    /** @type {Vector | null} */
    this.up = null;
    /** @type {Vector | null} */
    this.goal = null;
    /** @type {string | null} */
    this.cable = null;
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.last = 0;
    this.frames = 0;
    this.colours = colours();
    requestAnimationFrame((now) => this.frame(now));
  }

  recolour() {
    this.colours = colours();
  }

  /** @param {number} now */
  frame(now) {
    const passed = Math.min(now - this.last, 200);
    this.last = now;
    if (this.up) {
      // The heading is seen by nothing: the box turns by the shortest way that brings its new "up" to the top.
      const { axis, angle } = smallestTurn(apply(this.attitude, this.up), UP);
      const share = this.calm.matches ? 1 : 1 - Math.exp(-passed / FOLLOW_MS);
      if (angle > 1e-4) this.attitude = orthonormal(product(rotation(axis, angle * share), this.attitude));
    }
    if (!document.hidden) this.draw();
    this.frames += 1;
    requestAnimationFrame((time) => this.frame(time));
  }

  draw() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = Math.round(width * ratio);
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = Math.round(height * ratio);
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!this.up) return;
    const beside = this.goal !== null;
    const wide = width > 1.15 * height;
    const size = Math.min(wide && beside ? width / 2 : width, height) / 2 / REACH;
    const [box, goal, text, arrow] = this.colours;
    const here = beside && wide ? width / 4 : width / 2;
    const shift = beside && !wide ? size * 0.7 : 0;
    if (this.goal && !wide) {
      // Small behind, in the corner: there is no room for two.
      this.solid(context, this.wanted(), [width - size, size * 1.02], size * 0.52, goal, text);
    } else if (this.goal) {
      this.solid(context, this.wanted(), [(3 * width) / 4, height / 2], size, goal, text);
    }
    this.solid(context, this.attitude, [here - shift * 0.4, height / 2 + shift * 0.35], size, box, text);
    if (this.goal) this.turn(context, [here - shift * 0.4, height / 2 + shift * 0.35], size, arrow);
  }

  /** @returns {Matrix} the attitude wanted, by the smallest turn from the present one */
  wanted() {
    const { axis, angle } = smallestTurn(apply(this.attitude, /** @type {Vector} */ (this.goal)), UP);
    return product(rotation(axis, angle), this.attitude);
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {Matrix} attitude @param {[number, number]} middle
   * @param {number} size @param {string} colour @param {string} ink
   */
  solid(context, attitude, middle, size, colour, ink) {
    const view = product(ONLOOKER, attitude);
    /** @param {Vector} point @returns {[number, number]} */
    const place = (point) => {
      const seen = apply(view, point);
      return [middle[0] + seen[0] * size, middle[1] - seen[2] * size];
    };
    const cable = this.cable;
    const foot = cable ? /** @type {Vector} */ (HALF.map((half, k) => (AXES[k] === cable[1] ? (cable[0] === "+" ? half : -half) : 0))) : null;
    const end = foot ? /** @type {Vector} */ (foot.map((value) => value + Math.sign(value) * CABLE)) : null;
    const drawCable = () => {
      if (!foot || !end) return;
      context.strokeStyle = ink;
      context.lineWidth = size * 0.09;
      context.lineCap = "round";
      context.beginPath();
      context.moveTo(...place(foot));
      context.lineTo(...place(end));
      context.stroke();
    };
    const behind = foot !== null && apply(view, foot)[1] > 0;
    if (behind) drawCable();
    for (let axis = 0; axis < 3; axis++) {
      for (const sign of [1, -1]) {
        const normal = /** @type {Vector} */ ([0, 1, 2].map((k) => (k === axis ? sign : 0)));
        if (apply(view, normal)[1] > -0.02) continue;
        const [j, k] = [(axis + 1) % 3, (axis + 2) % 3];
        const corners = [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => {
          const corner = normal.map((value, place) => value * HALF[place]);
          corner[j] = a * HALF[j];
          corner[k] = b * HALF[k];
          return place(/** @type {Vector} */ (corner));
        });
        const lit = 0.55 + 0.45 * Math.max(0, dot(apply(attitude, normal), LIGHT));
        context.fillStyle = colour;
        context.strokeStyle = ink;
        context.lineWidth = Math.max(1, size * 0.02);
        context.lineJoin = "round";
        context.beginPath();
        corners.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
        context.closePath();
        context.fill();
        context.fillStyle = `rgba(0, 0, 0, ${(1 - lit) * 0.75})`;
        context.fill();
        context.stroke();
        context.fillStyle = "#fff";
        context.font = `700 ${Math.max(10, size * 0.3)}px system-ui, sans-serif`;
        context.textAlign = "center";
        context.textBaseline = "middle";
        const [x, y] = corners.reduce((sum, corner) => [sum[0] + corner[0] / 4, sum[1] + corner[1] / 4], [0, 0]);
        context.fillText(`${sign > 0 ? "+" : "−"}${AXES[axis]}`, x, y);
      }
    }
    if (!behind) drawCable();
  }

  /**
   * Draw the smallest turn to the goal as an arrow about its axis.
   * @param {CanvasRenderingContext2D} context @param {[number, number]} middle @param {number} size @param {string} colour
   */
  turn(context, middle, size, colour) {
    const { axis, angle } = smallestTurn(apply(this.attitude, /** @type {Vector} */ (this.goal)), UP);
    if (angle < 0.12) return;
    const begin = smallestTurn(UP, axis).angle > 0.2 ? /** @type {Vector} */ (UP) : /** @type {Vector} */ ([1, 0, 0]);
    const along = dot(begin, axis);
    const radius = /** @type {Vector} */ (begin.map((value, k) => (value - along * axis[k]) * 1.55));
    const steps = Math.max(6, Math.ceil(angle * 12));
    const points = Array.from({ length: steps + 1 }, (_, step) => {
      const seen = apply(ONLOOKER, apply(rotation(axis, ((step / steps) * 1 - 0.5) * angle), radius));
      return /** @type {[number, number]} */ ([middle[0] + seen[0] * size, middle[1] - seen[2] * size]);
    });
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = Math.max(3, size * 0.08);
    context.lineCap = "round";
    context.beginPath();
    points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
    const [tip, before] = [points[steps], points[steps - 1]];
    const heading = Math.atan2(tip[1] - before[1], tip[0] - before[0]);
    const head = size * 0.24;
    context.beginPath();
    context.moveTo(tip[0] + Math.cos(heading) * head, tip[1] + Math.sin(heading) * head);
    for (const side of [2.3, -2.3]) context.lineTo(tip[0] + Math.cos(heading + side) * head, tip[1] + Math.sin(heading + side) * head);
    context.closePath();
    context.fill();
  }
}
