// The instrument as a box with named faces, a cable and light from above, and the turn that brings it where it should be.

import { colour, prepare } from "./canvas.js";
import { boxShape } from "./shape.js";
import { text } from "./texts.js";
import { UNTURNED, apply, dot, orthonormal, product, rotation, smallestTurn } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {import("./vectors.js").Matrix} Matrix */

const AXES = "xyz";
/** @type {Vector} */
const UP = [0, 0, 1];
// The onlooker looks a little from above and from one side: three faces are seen in almost every attitude.
const ONLOOKER = product(rotation([1, 0, 0], (24 * Math.PI) / 180), rotation([0, 0, 1], (33 * Math.PI) / 180));
/** @type {Vector} */
const LIGHT = [-0.35, -0.6, 0.72];
const CABLE = 0.8;
const REACH = 1.75;
const LEAST_TURN = 0.12; // rad: a smaller one is as good as done.
const BAND_RADIUS = 1.5; // Of the arrow, beyond the corners of the box.
const BAND = 0.13; // Half of its width.
const BAND_HEAD = 0.42; // rad
const FOLLOW_MS = 60; // The box is where the newest sample says after about two frames.

/** @param {string} paint "#2f6fb5" @param {number} light from 0 to 1 @returns {string} */
function shaded(paint, light) {
  const share = 0.66 + 0.34 * light;
  return `rgb(${[1, 3, 5].map((at) => Math.round(parseInt(paint.slice(at, at + 2), 16) * share)).join(" ")})`;
}

/**
 * Make a closed path of corners as the onlooker sees them.
 * @param {CanvasRenderingContext2D} context @param {Vector[]} corners @param {[number, number]} middle @param {number} size
 */
function surround(context, corners, middle, size) {
  context.beginPath();
  for (const [x, , z] of corners) context.lineTo(middle[0] + x * size, middle[1] - z * size);
  context.closePath();
}

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
    this.shape = boxShape();
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.last = 0;
    requestAnimationFrame((now) => this.frame(now));
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
    requestAnimationFrame((time) => this.frame(time));
  }

  draw() {
    const { context, width, height } = prepare(this.canvas);
    if (!this.up) return;
    const isWide = width > 440 && width > 1.15 * height;
    /** @type {[number, number]} */
    let middle = [width / 2, height / 2];
    let size = Math.min(width, height) / 2 / REACH;
    if (this.goal) {
      // Side by side, or small in the corner where there is no room for two.
      size = Math.min(isWide ? width / 2 : 0.88 * width, height) / 2 / REACH;
      const share = isWide ? 1 : 0.5;
      /** @type {[number, number]} */
      const there = isWide ? [(3 * width) / 4, height / 2] : [width - size, size * share * REACH + 4];
      middle = isWide ? [width / 4, height / 2] : [width / 2 - 0.5 * size, height / 2 + 0.3 * size];
      this.solid(context, this.wanted(), there, size * share, colour("goal"));
      this.turn(context, middle, size, true);
      this.solid(context, this.attitude, middle, size, colour("box"));
      this.turn(context, middle, size, false);
      this.caption(context, text("goal"), [there[0], isWide ? height / 2 + size * REACH - 6 : 16]);
      this.caption(context, text("now"), [middle[0], Math.min(middle[1] + size * REACH, height) - 6]);
    } else this.solid(context, this.attitude, middle, size, colour("box"));
    this.pointUp(context, height);
  }

  /** @param {CanvasRenderingContext2D} context @param {string} words @param {[number, number]} place below its middle */
  caption(context, words, [x, y]) {
    context.font = "600 16px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    // The cable may run behind it.
    context.strokeStyle = colour("panel");
    context.lineWidth = 5;
    context.strokeText(words, x, y);
    context.fillStyle = colour("faint");
    context.fillText(words, x, y);
  }

  /** Up is up in both pictures. @param {CanvasRenderingContext2D} context @param {number} height */
  pointUp(context, height) {
    const [x, top, foot] = [14, 14, Math.min(74, height / 3)];
    this.caption(context, text("up"), [x, foot + 18]);
    context.strokeStyle = colour("faint");
    context.lineWidth = 4;
    context.lineCap = context.lineJoin = "round";
    context.beginPath();
    context.moveTo(x, foot);
    context.lineTo(x, top);
    context.moveTo(x - 8, top + 10);
    context.lineTo(x, top);
    context.lineTo(x + 8, top + 10);
    context.stroke();
  }

  /** @returns {Matrix} the attitude wanted, by the smallest turn from the present one */
  wanted() {
    const { axis, angle } = smallestTurn(apply(this.attitude, /** @type {Vector} */ (this.goal)), UP);
    return product(rotation(axis, angle), this.attitude);
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {Matrix} attitude @param {[number, number]} middle
   * @param {number} size @param {string} paint
   */
  solid(context, attitude, middle, size, paint) {
    const ink = colour("text");
    const view = product(ONLOOKER, attitude);
    /** @param {Vector} point @returns {[number, number]} */
    const place = (point) => {
      const seen = apply(view, point);
      return [middle[0] + seen[0] * size, middle[1] - seen[2] * size];
    };
    const cable = this.cable;
    const out = cable ? /** @type {Vector} */ ([...AXES].map((axis) => (axis === cable[1] ? (cable[0] === "+" ? 1 : -1) : 0))) : null;
    // Beside the middle, where the face has its name.
    const foot = out ? /** @type {Vector} */ (this.shape.half.map((half, k) => half * (out[k] || (this.shape.hasEdges ? -0.55 : 0)))) : null;
    const end = out && foot ? /** @type {Vector} */ (foot.map((value, k) => value + out[k] * CABLE)) : null;
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
    const behind = out !== null && apply(view, out)[1] > 0;
    /** @type {{name: string, at: [number, number]}[]} */
    const names = [];
    if (behind) drawCable();
    context.strokeStyle = ink;
    context.lineJoin = "round";
    const { faces, half, hasEdges } = this.shape;
    const turned = faces
      .filter(({ normal }) => apply(view, normal)[1] < -0.02)
      .map(({ corners, normal }) => ({ normal, seen: corners.map((corner) => apply(view, corner)) }))
      .map(({ normal, seen }) => ({ normal, seen, depth: seen.reduce((sum, corner) => sum + corner[1], 0) / seen.length }));
    // What is nearer is painted over what is behind.
    for (const { normal, seen } of turned.sort((a, b) => b.depth - a.depth)) {
      context.fillStyle = shaded(paint, Math.max(0, dot(apply(attitude, normal), LIGHT)));
      context.lineWidth = hasEdges ? Math.max(1, size * 0.02) : 0.7;
      // Of triangles no edge is to be seen, nor a gap between two.
      if (!hasEdges) context.strokeStyle = context.fillStyle;
      surround(context, seen, middle, size);
      context.fill();
      context.stroke();
    }
    for (const [axis, letter] of [...AXES].entries()) {
      for (const sign of [1, -1]) {
        const normal = /** @type {Vector} */ ([0, 1, 2].map((k) => (k === axis ? sign : 0)));
        // A face that is seen from the side has no room for its name.
        if (apply(view, normal)[1] > -0.3) continue;
        names.push({ name: `${sign > 0 ? "+" : "−"}${letter}`, at: place(/** @type {Vector} */ (normal.map((value, k) => value * half[k]))) });
      }
    }
    if (!behind) drawCable();
    context.fillStyle = colour("ink");
    context.font = `700 ${Math.max(10, size * 0.3)}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.strokeStyle = paint;
    context.lineWidth = size * 0.08;
    for (const { name, at } of names) {
      context.strokeText(name, ...at);
      context.fillText(name, ...at);
    }
  }

  /**
   * Draw the smallest turn to the goal as a band about its axis, which is level.
   * @param {CanvasRenderingContext2D} context @param {[number, number]} middle @param {number} size
   * @param {boolean} isBehind which part: that behind the box, or that before it
   */
  turn(context, middle, size, isBehind) {
    const { axis, angle } = smallestTurn(apply(this.attitude, /** @type {Vector} */ (this.goal)), UP);
    if (angle < LEAST_TURN) return;
    /** @param {number} turned @param {number} across @returns {Vector} right, away from the onlooker, up */
    const seen = (turned, across) => {
      const [x, y, z] = apply(rotation(axis, turned - angle / 2), [0, 0, BAND_RADIUS]);
      return apply(ONLOOKER, [x + across * axis[0], y + across * axis[1], z + across * axis[2]]);
    };
    const head = Math.min(BAND_HEAD, 0.6 * angle);
    const steps = Math.max(4, Math.ceil(angle * 10));
    const share = (angle - head) / steps;
    /** @type {Vector[][]} */
    const pieces = [];
    for (let step = 0; step < steps; step++) {
      const [from, to] = [step * share, (step + 1.05) * share];
      pieces.push([seen(from, BAND), seen(to, BAND), seen(to, -BAND), seen(from, -BAND)]);
    }
    // The head lies in the picture: from every side it is an arrow's.
    const [neck, tip] = [seen(angle - head, 0), seen(angle, 0)];
    const [right, up] = [tip[0] - neck[0], tip[2] - neck[2]];
    const wide = (2 * BAND) / (Math.hypot(right, up) || 1);
    pieces.push([[neck[0] - wide * up, neck[1], neck[2] + wide * right], tip, [neck[0] + wide * up, neck[1], neck[2] - wide * right]]);
    context.fillStyle = colour("arrow");
    for (const corners of pieces) {
      if (corners.reduce((sum, corner) => sum + corner[1], 0) > 0 !== isBehind) continue;
      surround(context, corners, middle, size);
      context.fill();
    }
  }
}
