// Requests to the server, and its refusals, each beside the field that it is about.

import { $, sentence } from "./dom.js";

export class Refused extends Error {
  constructor(field, message) { super(message); this.field = field; }
}

export async function ask(address, options = {}) {
  let answer;
  try {
    answer = await fetch(address, options);
  } catch {
    throw new Refused("page", "The studio no longer answers: start cep studio again, and open the address that it prints. Nothing here is lost.");
  }
  const text = await answer.text();
  let found = {};
  try { found = JSON.parse(text); } catch { /* a refusal in plain text */ }
  if (!answer.ok) throw new Refused(found.error?.field ?? "page", found.error?.message ?? text.slice(0, 200));
  return found;
}

const send = (name, type, body) => ask(`/api/${name}`, { method: "POST", headers: { "Content-Type": `application/${type}` }, body });
export const post = (name, body) => send(name, "json", JSON.stringify(body));
export const upload = (name, file) => send(`upload/${name}`, "octet-stream", file);

/** Show a refusal beside its field, until what was asked for (`by`) is calm again. */
export function complain(error, by = "") {
  if (!(error instanceof Refused)) throw error;
  const box = document.querySelector(`.error[data-for~="${CSS.escape(error.field)}"]`) ?? document.querySelector('.error[data-for~="page"]');
  box.textContent = sentence(error.message);
  box.dataset.by = by;
  for (const input of inputsOf(error.field)) input.setAttribute("aria-invalid", "true");
}

export function calm(by) {
  for (const box of document.querySelectorAll(".error")) {
    if (box.dataset.by !== by || !box.textContent) continue;
    box.textContent = "";
    for (const name of box.dataset.for.split(" ")) for (const input of inputsOf(name)) input.removeAttribute("aria-invalid");
  }
}

/** Inputs that set a field: two for the range of open chips. */
function inputsOf(field) {
  return (field === "open" ? ["open-low", "open-high"] : [field]).map($).filter(Boolean);
}
