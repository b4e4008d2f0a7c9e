// How long a session takes with what was chosen, asked of the program whenever that changes.

import { at, filled } from "./make.js";

/**
 * @param {import("./bench.js").Bench} bench
 * @param {() => any} noise what is known of the noise of the instrument, as `plan` takes it
 * @returns {() => Promise<void>} to be called where that has changed
 */
export function watchPlan(bench, noise) {
  const form = at("plan");
  let asked = "";
  const ask = async () => {
    const { positions, target_bias_ug, target_scale_ppm } = filled(form);
    const values = { positions, target_bias_ug, target_scale_ppm, ...noise() };
    const mine = JSON.stringify(values);
    if (form.closest("[data-view]").hidden || mine === asked) return;
    asked = mine;
    const says = await bench.found("plan", values).then(
      (found) => `${found.words}. ${found.assumed}.`,
      (/** @type {Error} */ error) => error.message,
    );
    // Of what was chosen in the meantime the answer comes later.
    if (mine === asked) at("plan-says").textContent = says.replace(/^./, (letter) => letter.toUpperCase());
  };
  form.addEventListener("change", ask);
  return ask;
}
