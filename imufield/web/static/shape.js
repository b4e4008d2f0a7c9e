// What stands for the instrument: a box, or the triangles of the user's own drawing.

import { cross, unit } from "./vectors.js";

/** @typedef {import("./vectors.js").Vector} Vector */
/** @typedef {{corners: Vector[], normal: Vector}} Face */
/** @typedef {{faces: Face[], half: Vector, hasEdges: boolean}} Shape half: of its extent along each axis */

/** @type {Vector} */
const HALF = [1, 0.72, 0.42];

/** @param {Vector[]} corners seen from outside, against the clock @returns {Face} */
function face(corners) {
  const [a, b, c] = corners;
  const [along, up] = [b, c].map((corner) => /** @type {Vector} */ (corner.map((value, k) => value - a[k])));
  return { corners, normal: unit(cross(along, up)) };
}

/** @returns {Shape} */
export function boxShape() {
  const faces = [0, 1, 2].flatMap((axis) =>
    [1, -1].map((sign) => {
      const [j, k] = sign > 0 ? [(axis + 1) % 3, (axis + 2) % 3] : [(axis + 2) % 3, (axis + 1) % 3];
      return face(
        [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => {
          /** @type {Vector} */
          const corner = [0, 0, 0];
          [corner[axis], corner[j], corner[k]] = [sign * HALF[axis], a * HALF[j], b * HALF[k]];
          return corner;
        }),
      );
    }),
  );
  return { faces, half: HALF, hasEdges: true };
}

/** @param {string} drawing base64 of nine 16-bit integers for each triangle @returns {Shape} */
export function drawnShape(drawing) {
  const bytes = Uint8Array.from(atob(drawing), (letter) => letter.charCodeAt(0));
  const numbers = new Int16Array(bytes.buffer);
  // Its longest side fills the picture.
  const largest = numbers.reduce((most, value) => Math.max(most, Math.abs(value)), 1);
  const values = Array.from(numbers, (value) => value / largest);
  const corners = Array.from({ length: values.length / 3 }, (_, k) => /** @type {Vector} */ (values.slice(3 * k, 3 * k + 3)));
  const faces = Array.from({ length: corners.length / 3 }, (_, k) => face(corners.slice(3 * k, 3 * k + 3)));
  const half = /** @type {Vector} */ ([0, 1, 2].map((k) => corners.reduce((most, corner) => Math.max(most, Math.abs(corner[k])), 0)));
  return { faces, half, hasEdges: false };
}
