// The words of the page, which stand in its HTML.

/**
 * @param {string} name @param {Record<string, string | number>} [values] for the braces of the text
 * @returns {string}
 */
export function text(name, values = {}) {
  const texts = /** @type {HTMLTemplateElement} */ (document.getElementById("texts"));
  const found = texts.content.querySelector(`[data-text="${name}"]`);
  if (!found) throw new Error(`no text ${name}`);
  return (found.textContent ?? "").replace(/\{(\w+)\}/g, (_, value) => String(values[value]));
}

/**
 * A sentence of the guide, with the marks that it names in brackets as this page says them.
 * @param {string} words @param {string} how name of the text for a mark
 */
export const withMarks = (words, how) => words.replace(/\[([a-z ]+)\]/g, (_, mark) => text(how, { mark }));

// A hyphen ends a line: "near -" and "y" below it read as +y. What is to be typed, an option with its value or in quotes, keeps it.
const NEGATIVE = /--[\w-]+ \S+|(?<![\w+=-])(?:-(?=\d)|(?:[+-][xyz])+(?![\w'+-]))/g;

/** Words as a terminal can show them, with the signs of units, sides and numbers; options stay. @param {string} words */
export const withSigns = (words) =>
  words.replace(NEGATIVE, (found) => (found.startsWith("--") ? found : found.replaceAll("-", "−"))).replaceAll("^2", "²").replaceAll(" per root Hz", "/√Hz").replace(/(?<![\w-])u(?=g\b|rad\b)/g, "µ").replace(/ deg\b/g, "°").replace(/(?<![\d.])\+-(?=\d)/g, "±");

/**
 * Words that name options, with the fields of the page in place of those that it has; what is a command stays.
 * @param {string} words @param {string} place a selector of what the fields are in
 */
export const withFields = (words, place) =>
  words.replace(/(?<!imufield [^.;:]*)--([a-z]+(?:-[a-z]+)*)/g, (option, name) => {
    const field = document.querySelector(`${place} :is([name="${name.replaceAll("-", "_")}"], #${name})`);
    const label = field?.closest("label")?.firstChild?.textContent;
    return label ? `“${label.trim().replace(/^or |,.*/gs, "")}”` : option;
  });

/** A number with its sign; what is rounded to zero has none. @param {number} value @param {number} digits */
export function signed(value, digits) {
  const size = Math.abs(value).toFixed(digits);
  return `${Number(size) === 0 ? "" : value < 0 ? "−" : "+"}${size}`;
}

/** Day and time of a date as files have it. @param {string | undefined} date */
export const when = (date) => (date ?? "").slice(0, 16).replace("T", " ");
