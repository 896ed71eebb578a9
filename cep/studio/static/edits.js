// Edits of a code as a whole, and the number of its chips.

/** What the buttons do, by their names. */
export const EDITS = {
  invert: (bits) => {
    const other = [...bits].map((bit) => (bit === "1" ? "0" : "1")).join("");
    return other.includes("1") ? other : bits;
  },
  mirror: (bits) => [...bits].reverse().join(""),
  left: (bits) => bits.slice(1) + bits[0],
  right: (bits) => bits.at(-1) + bits.slice(0, -1),
  random: shuffled,
};

/** Chips that a motion tells apart, a quarter of a pixel each; any number where its length is not known here. */
export function mostChips({ kind, length, x, y }) {
  const path = kind === "path" ? x.slice(1).reduce((sum, at, i) => sum + Math.hypot(at - x[i], y[i + 1] - y[i]), 0) : Number(length);
  return Number.isFinite(path) && path > 0 ? Math.max(1, Math.floor(4 * path)) : 512;
}

export function resized(bits, count) {
  const chips = Math.min(Math.max(Math.round(count) || 2, 2), 512);
  if (chips === bits.length) return bits;
  // every new chip shows what the old code had at its time
  const next = Array.from({ length: chips }, (_, i) => bits[Math.min(Math.floor(((i + 0.5) * bits.length) / chips), bits.length - 1)]).join("");
  return next.includes("1") ? next : `1${next.slice(1)}`;
}

function shuffled(bits) {
  const chips = [...bits];
  for (let i = chips.length - 1; i > 0; i--) { const j = Math.floor(Math.random() * (i + 1)); [chips[i], chips[j]] = [chips[j], chips[i]]; }
  return chips.join("");
}
