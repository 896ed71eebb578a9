// Elements of the page: found by their names, filled, made.

export const $ = (id) => document.getElementById(id);

/** Put a text into its place: one that is there already is not laid out anew. */
export function say(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

/** Put a value into a field; one that is being typed in is left alone. */
export function put(id, value) {
  const text = /number|range/.test($(id).type) && !Number.isFinite(Number(value)) ? "" : String(value); // as an address may have it
  if (document.activeElement !== $(id) && $(id).value !== text) $(id).value = text;
}

/** A text as a sentence: with a capital letter and a full stop. */
export function sentence(text) {
  const whole = text.trim();
  return whole.charAt(0).toUpperCase() + whole.slice(1) + (/[.!?]$/.test(whole) ? "" : ".");
}

/** A row of the list of warnings, a cell of a table: an element that holds a text. */
export function holding(tag, text, className = "") {
  return Object.assign(document.createElement(tag), { textContent: text, className });
}
