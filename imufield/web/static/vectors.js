// Three numbers, and turns as matrices of three rows.

/** @typedef {[number, number, number]} Vector */
/** @typedef {[Vector, Vector, Vector]} Matrix */

/** @type {Matrix} */
export const UNTURNED = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** @param {Matrix} m @param {Vector} v @returns {Vector} */
export const apply = (m, v) => [dot(m[0], v), dot(m[1], v), dot(m[2], v)];

/** @param {Matrix} m @returns {Matrix} */
export const transposed = (m) => [
  [m[0][0], m[1][0], m[2][0]],
  [m[0][1], m[1][1], m[2][1]],
  [m[0][2], m[1][2], m[2][2]],
];

/** @param {Matrix} a @param {Matrix} b @returns {Matrix} */
export const product = (a, b) => {
  const columns = transposed(b);
  return /** @type {Matrix} */ (a.map((row) => columns.map((column) => dot(row, column))));
};

/** @param {Vector} v @returns {Vector} */
export const unit = (v) => {
  const length = Math.hypot(...v) || 1;
  return [v[0] / length, v[1] / length, v[2] / length];
};

/** @param {Vector} axis unit vector @param {number} angle rad @returns {Matrix} */
export const rotation = (axis, angle) => {
  const [x, y, z] = axis;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const d = 1 - c;
  return [
    [c + x * x * d, x * y * d - z * s, x * z * d + y * s],
    [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
    [z * x * d - y * s, z * y * d + x * s, c + z * z * d],
  ];
};

/**
 * The smallest turn that brings one direction to another: its axis and angle.
 * @param {Vector} from @param {Vector} to unit vectors
 * @returns {{axis: Vector, angle: number}}
 */
export const smallestTurn = (from, to) => {
  const normal = cross(from, to);
  const sine = Math.hypot(...normal);
  const angle = Math.atan2(sine, dot(from, to));
  if (sine > 1e-9) return { axis: unit(normal), angle };
  // The same direction, or the opposite one: any axis across will do.
  return { axis: unit(Math.abs(from[0]) < 0.9 ? cross(from, [1, 0, 0]) : cross(from, [0, 1, 0])), angle };
};

/** @param {Matrix} m @returns {Matrix} rows made unit and square again: rounding adds up over thousands of frames. */
export const orthonormal = (m) => {
  const x = unit(m[0]);
  const z = unit(cross(x, m[1]));
  return [x, cross(z, x), z];
};
