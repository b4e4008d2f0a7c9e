// How long a session takes with what was chosen, asked of the program whenever that changes.

import { at, filled } from "./make.js";
import { text, withFields, withSigns } from "./texts.js";

/**
 * @param {import("./bench.js").Bench} bench
 * @param {() => any} noise what is known of the noise of the instrument, as `plan` takes it
 * @returns {() => Promise<void>} to be called where that has changed
 */
export function watchPlan(bench, noise) {
  const [form, place, grade] = [at("plan"), at("place"), at("grade")];
  let asked = "";
  const ask = async () => {
    const { positions, target_bias_ug, target_scale_ppm } = filled(form);
    const wanted = { positions, target_bias_ug, target_scale_ppm, ...filled(place) };
    const values = { ...wanted, ...noise(), ...(grade.value ? { grade: grade.value } : {}) };
    const mine = JSON.stringify(values);
    if (form.closest("[data-view]").hidden || mine === asked) return;
    asked = mine;
    at("plan-says").textContent = text("planning");
    const says = await bench.found("plan", values).then(
      ({ words, remedy, assumed }) =>
        withSigns(
          [words, remedy, assumed]
            .filter(Boolean)
            .map((part) => withFields(`${part[0].toUpperCase()}${part.slice(1).replace(/\.$/, "")}.`, "[data-view=calibrate]"))
            .join(" "),
        ),
      (/** @type {Error} */ error) => error.message,
    );
    // Of what was chosen in the meantime the answer comes later.
    if (mine === asked) at("plan-says").textContent = says;
  };
  for (const field of [form, place, grade]) field.addEventListener("change", ask);
  return ask;
}
