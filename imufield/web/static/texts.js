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
