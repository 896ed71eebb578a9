// The table of codes: this one, the pinned ones, and the exposures that it is compared with.

import { holding } from "./dom.js";
import { miniature } from "./strip.js";

const drawn = new WeakMap(); // rows as they are drawn

export const digits = (x) => (x === 0 ? "0" : x.toPrecision(3));
export const noise = (gain_db) => (gain_db === null ? "> 100" : gain_db.toFixed(1));

/** Draw the rows that have changed; `acts` says what the buttons do that a row names. */
export function drawRows(body, rows, acts) {
  while (body.rows.length > rows.length) body.deleteRow(-1);
  rows.forEach((row, index) => {
    const looks = JSON.stringify(row), before = body.rows[index];
    if (before && drawn.get(before) === looks) return;
    const line = document.createElement("tr");
    drawn.set(line, looks);
    if (!index) line.className = "mark";
    const head = document.createElement("td");
    head.append(holding("span", row.note ? `${row.name} (${row.note})` : row.name), miniature(row.bits));
    const { min_mtf, noise_gain_db, psnr_db } = row.figures ?? {};
    const light = row.bits.split("1").length - 1;
    const cells = [
      `${Math.round((100 * light) / row.bits.length)} %`,
      known(min_mtf) ? digits(min_mtf) : "–",
      noise_gain_db === undefined ? "–" : noise(noise_gain_db),
      known(psnr_db) ? psnr_db.toFixed(2) : "–",
    ];
    const buttons = holding("td", "", "n");
    for (const name of row.acts) {
      const label = `${name[0].toUpperCase()}${name.slice(1)} ${row.name}`;
      buttons.append(buttons.hasChildNodes() ? " " : "", act(name, label, () => acts[name](row)));
    }
    line.append(head, ...cells.map((text) => holding("td", text, "n")), buttons);
    if (before) before.replaceWith(line); else body.append(line);
  });
}

const known = (figure) => figure !== undefined && figure !== null;

/** A button that looks like a link. */
function act(text, label, does) {
  const button = holding("button", text, "link");
  button.type = "button";
  button.setAttribute("aria-label", label);
  button.addEventListener("click", does);
  return button;
}
