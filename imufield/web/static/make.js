// Elements of the page: made of nodes and never of text, so that no name of an instrument or a file is markup.

const SVG = "http://www.w3.org/2000/svg";
// What would show text in another order than it has, or end lines.
const HIDDEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u2028-\u202e\u2066-\u2069]/g;

/** @param {unknown} text */
export const clean = (text) => String(text).replace(HIDDEN, "\ufffd");

const SURE_MS = 10000; // As on the page of the guide.

/** The time now as names of folders begin or end. */
export const stamp = () => new Date().toISOString().replace(/[-:]|\.\d+/g, "");

/** @param {string} id @returns {any} */
export const at = (id) => document.getElementById(id);

/**
 * @param {Element} element
 * @param {Record<string, any>} properties attributes; "on..." are listeners, false and null leave one out
 * @param {any[]} children elements and texts; null and false are left out
 */
function fill(element, properties, children) {
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null && value !== undefined)
      element.setAttribute(name, value === true ? "" : clean(value));
  }
  for (const child of children.flat()) {
    if (child === null || child === undefined || child === false) continue;
    element.append(child instanceof Node ? child : clean(child));
  }
  return element;
}

/** @param {string} tag @param {Record<string, any>} [properties] @param {any[]} children @returns {any} */
export const make = (tag, properties = {}, ...children) => fill(document.createElement(tag), properties, children);

/** @param {string} tag @param {Record<string, any>} [properties] @param {any[]} children @returns {any} */
export const draw = (tag, properties = {}, ...children) => fill(document.createElementNS(SVG, tag), properties, children);

/** @param {string} words @param {() => void} onclick @param {Record<string, any>} [more] */
export const button = (words, onclick, more = {}) => make("button", { type: "button", onclick, ...more }, words);

/**
 * A button that asks: a second tap within ten seconds is for sure.
 * @param {string} words @param {string} sure @param {() => void} act
 */
export function sureButton(words, sure, act) {
  let timer = 0;
  const made = button(words, () => {
    clearTimeout(timer);
    const isSure = made.textContent === sure;
    made.textContent = isSure ? words : sure;
    if (isSure) act();
    else timer = setTimeout(() => (made.textContent = words), SURE_MS);
  });
  return made;
}

/**
 * @param {string[]} head
 * @param {any[][]} rows
 * @param {string} [how] "stacks": on a narrow screen the cells of a row stand below each other, each with its name
 */
export const table = (head, rows, how = "") =>
  make(
    "div",
    { class: `wide ${how}` },
    make(
      "table",
      {},
      make("thead", {}, make("tr", {}, head.map((words) => make("th", { scope: "col" }, words)))),
      make("tbody", {}, rows.map((row) => make("tr", {}, row.map((cell, k) => make("td", { "data-head": head[k] }, cell))))),
    ),
  );

/**
 * The values of a form's fields that are filled in, numbers as numbers.
 * @param {HTMLElement} form
 * @returns {Record<string, any>}
 */
export function filled(form) {
  /** @type {Record<string, any>} */
  const values = {};
  for (const field of /** @type {NodeListOf<any>} */ (form.querySelectorAll("[name]"))) {
    const text = field.value.trim();
    if (field.type === "checkbox" ? !field.checked : !text) continue;
    const number = field.inputMode === "decimal" ? Number(text.replace(",", ".")) : NaN;
    // What should be a number and is none, or is too large for one, is refused with what was typed.
    values[field.name] = field.type === "checkbox" ? true : Number.isFinite(number) ? number : text;
  }
  return values;
}
