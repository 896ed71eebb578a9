// The strip of chips: a switch for each, toggled by click, painted by dragging, walked by the keyboard.

const ROW_PX = 56;
// a chip's least width: a finger covers more than a mouse points at
const NARROWEST_PX = matchMedia("(pointer: coarse)").matches || innerWidth < 640 ? 24 : 7;

export class Strip {
  /**
   * @param {HTMLElement} box
   * @param {(bits: string, done: boolean) => void} onChange `done` is false while a finger is still painting
   */
  constructor(box, onChange) {
    this.box = box;
    this.onChange = onChange;
    this.bits = "";
    this.at = 0;
    this.paint = null;
    box.addEventListener("pointerdown", (event) => this.begin(event));
    box.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) box.addEventListener(name, () => this.end());
    box.addEventListener("focusin", (event) => { const i = this.indexOf(event.target); if (i >= 0) this.at = i; });
    box.addEventListener("keydown", (event) => this.key(event));
    // a screen reader's click has no pointer before it
    box.addEventListener("click", (event) => { if (event.detail === 0) this.flip(this.indexOf(event.target)); });
    new ResizeObserver(() => this.layOut()).observe(box);
  }

  set(bits) {
    if (bits.length !== this.bits.length) {
      this.box.replaceChildren(...Array.from(bits, (_, i) => chip(i)));
      this.at = Math.min(this.at, bits.length - 1);
      this.bits = "";
      this.layOut(bits.length);
    }
    for (let i = 0; i < bits.length; i++) if (bits[i] !== this.bits[i]) this.draw(i, bits[i], bits.length);
    this.bits = bits;
    this.box.querySelectorAll('[tabindex="0"]').forEach((one) => { one.tabIndex = -1; });
    if (this.box.children[this.at]) this.box.children[this.at].tabIndex = 0;
  }

  draw(i, bit, count) {
    const one = this.box.children[i];
    one.setAttribute("aria-checked", bit === "1");
    one.setAttribute("aria-label", `chip ${i + 1} of ${count}, ${bit === "1" ? "open" : "closed"}`);
  }

  layOut(count = this.bits.length) {
    const width = this.box.clientWidth || 1;
    const rows = Math.max(1, Math.ceil((count * NARROWEST_PX) / width));
    this.box.style.gridTemplateColumns = `repeat(${Math.ceil(count / rows)}, 1fr)`;
    if (rows === 1) this.box.style.removeProperty("--chip-height");
    else this.box.style.setProperty("--chip-height", `${ROW_PX}px`);
  }

  indexOf(target) {
    return [...this.box.children].indexOf(target);
  }

  under(event) {
    return this.indexOf(document.elementFromPoint(event.clientX, event.clientY));
  }

  begin(event) {
    const i = this.under(event);
    if (i < 0 || event.button !== 0) return;
    event.preventDefault();
    this.box.setPointerCapture(event.pointerId);
    this.paint = { bit: this.bits[i] === "1" ? "0" : "1", last: i };
    this.focus(i);
    this.put(i, i, this.paint.bit, false);
  }

  move(event) {
    if (!this.paint) return;
    const i = this.under(event);
    if (i < 0 || i === this.paint.last) return;
    this.put(Math.min(i, this.paint.last), Math.max(i, this.paint.last), this.paint.bit, false);
    this.paint.last = i;
  }

  end() {
    if (!this.paint) return;
    this.paint = null;
    this.onChange(this.bits, true);
  }

  put(from, to, bit, done) {
    const bits = this.bits.slice(0, from) + bit.repeat(to - from + 1) + this.bits.slice(to + 1);
    if (!bits.includes("1") || (bits === this.bits && !done)) return; // one chip stays open
    this.set(bits);
    this.onChange(bits, done);
  }

  flip(i) {
    if (i >= 0) this.put(i, i, this.bits[i] === "1" ? "0" : "1", true);
  }

  focus(i) {
    this.box.children[this.at].tabIndex = -1;
    this.at = i;
    this.box.children[i].tabIndex = 0;
    this.box.children[i].focus({ preventScroll: true });
  }

  key(event) {
    const last = this.bits.length - 1;
    const to = { ArrowLeft: this.at - 1, ArrowRight: this.at + 1, Home: 0, End: last, PageUp: this.at - 8, PageDown: this.at + 8 }[event.key];
    if (to !== undefined) {
      event.preventDefault();
      const next = Math.min(Math.max(to, 0), last);
      if (event.shiftKey) this.put(Math.min(this.at, next), Math.max(this.at, next), this.bits[this.at], true);
      this.focus(next);
    } else if (event.key === " " || event.key === "Enter") {
      event.preventDefault();
      this.flip(this.at);
    } else if (event.key === "0" || event.key === "1") {
      event.preventDefault();
      this.put(this.at, this.at, event.key, true);
      this.focus(Math.min(this.at + 1, last));
    }
  }
}

function chip(i) {
  const one = document.createElement("button");
  one.type = "button";
  one.tabIndex = -1;
  one.setAttribute("role", "switch");
  one.dataset.chip = i;
  return one;
}

/** A code as a small picture. */
export function miniature(bits) {
  const box = document.createElement("span");
  box.className = "mini";
  const svg = make("svg", { viewBox: `0 0 ${bits.length} 1`, preserveAspectRatio: "none" });
  for (const run of bits.matchAll(/1+/g)) svg.append(make("rect", { x: run.index, y: 0, width: run[0].length, height: 1 }));
  box.append(svg);
  return box;
}

export function make(name, attributes = {}, text = null) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== null) element.textContent = text;
  return element;
}
