// Plots: MTF curves, MTF maps, paths, gains over the light, and what a controller played.

import { make } from "./strip.js";

const FLOOR_DB = -40;
const EDGE = { left: 0, right: 0, top: 0, bottom: 0 }; // px, by the size of the letters

// Sizes are measured when they change and not at every drawing: that would lay the page out once more each time.
const sizes = new WeakMap();
const watched = new ResizeObserver((changes) => changes.forEach((one) => sizes.delete(one.target)));

function sizeOf(svg) {
  if (!sizes.has(svg)) {
    watched.observe(svg);
    sizes.set(svg, { width: svg.clientWidth || 480, height: svg.clientHeight || 260, em: parseFloat(getComputedStyle(svg).fontSize) });
  }
  return sizes.get(svg);
}

const backgrounds = new WeakMap(); // what of a drawing stays from one code to the next, and what it depends on

/** Keep a drawing's background, or draw it where it has changed; all that was drawn upon it goes. */
function onBackground(svg, key, drawOn) {
  const kept = backgrounds.get(svg);
  if (kept?.key === key) {
    while (svg.lastChild !== kept.group) svg.lastChild.remove();
    return;
  }
  const group = make("g");
  svg.replaceChildren(group);
  backgrounds.set(svg, { key, group });
  drawOn(group);
}

/** A plot in pixels of the screen: axes, grid, and a function that places values. */
function frame(svg, axes) {
  const { x, y, xTicks, yTicks, xName, yName, xText = String, yText = String } = axes;
  const { width, height, em } = sizeOf(svg);
  Object.assign(EDGE, { left: 3.4 * em, right: 2.2 * em, top: 0.9 * em, bottom: 2.9 * em });
  const inner = { w: width - EDGE.left - EDGE.right, h: height - EDGE.top - EDGE.bottom };
  const px = (value) => EDGE.left + (inner.w * (value - x[0])) / (x[1] - x[0]);
  const py = (value) => EDGE.top + (inner.h * (y[1] - value)) / (y[1] - y[0]);
  onBackground(svg, JSON.stringify([width, height, em, axes]), (group) => {
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    for (const tick of yTicks) {
      group.append(make("line", { class: "grid", x1: EDGE.left, x2: width - EDGE.right, y1: py(tick), y2: py(tick) }));
      group.append(make("text", { x: EDGE.left - 0.5 * em, y: py(tick) + 0.35 * em, "text-anchor": "end" }, yText(tick)));
    }
    for (const tick of xTicks) group.append(make("text", { x: px(tick), y: height - EDGE.bottom + 1.3 * em, "text-anchor": "middle" }, xText(tick)));
    group.append(make("text", { x: EDGE.left + inner.w / 2, y: height - 0.3 * em, "text-anchor": "middle" }, xName));
    group.append(make("text", { x: width - EDGE.right, y: EDGE.top + 0.9 * em, "text-anchor": "end" }, yName));
  });
  return { px, py, width, height, em };
}

/** Pixels by their code value, black to white; heights are square roots, so that few pixels show; the last bar is white itself. */
export function drawHistogram(svg, counts, clipped) {
  const { width, height, em } = sizeOf(svg);
  const base = height - 1.6 * em, step = width / counts.length, most = Math.sqrt(Math.max(...counts, 1));
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("aria-label", `Histogram of the last frame: ${(100 * clipped).toPrecision(2)} percent of its pixels are white`);
  svg.replaceChildren(
    ...counts.map((count, i) => {
      const tall = (base * Math.sqrt(count)) / most;
      return make("rect", { class: i === counts.length - 1 ? "clipped" : "", x: i * step, width: 0.85 * step, y: base - tall, height: tall });
    }),
    make("line", { class: "zero", x1: 0, x2: width, y1: base, y2: base }),
    make("text", { x: 0, y: height - 0.3 * em }, "black"),
    make("text", { x: width / 2, y: height - 0.3 * em, "text-anchor": "middle" }, "code values of the last frame"),
    make("text", { x: width, y: height - 0.3 * em, "text-anchor": "end" }, "white"),
  );
}

function line(points) {
  return points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
}

/** Curves of MTF, each {values, class, name}, from 0 to 0.5 cycles/px. */
export function drawCurves(svg, curves) {
  const place = frame(svg, {
    x: [0, 0.5], y: [FLOOR_DB, 0], xTicks: [0, 0.1, 0.2, 0.3, 0.4, 0.5], yTicks: [0, -10, -20, -30, -40],
    xName: "spatial frequency, cycles/px", yName: "MTF, dB",
  });
  for (const { values, class: kind } of curves) {
    const step = 0.5 / (values.length - 1);
    const points = values.map((value, i) => [place.px(i * step), place.py(Math.max(20 * Math.log10(Math.max(value, 1e-9)), FLOOR_DB))]);
    svg.append(make("path", { class: `curve ${kind}`, d: line(points) }));
  }
  const code = curves.find((one) => one.class === "code");
  if (code) svg.setAttribute("aria-label", `MTF of this code: smallest along the motion ${Math.min(...code.values).toFixed(3)}, largest ${Math.max(...code.values).toFixed(3)}`);
}

// cividis, Nuñez et al. 2018, at nine places
const CIVIDIS = [[0, 34, 78], [18, 53, 112], [59, 73, 108], [87, 93, 109], [112, 113, 115], [138, 134, 120], [165, 156, 116], [195, 179, 105], [254, 232, 56]];

/** A map of MTF: half of the band from the server, the other half its mirror image. */
export function drawMap(canvas, { rows, columns, db }) {
  const half = Uint8Array.from(atob(db), (letter) => letter.charCodeAt(0));
  const side = columns, middle = rows - 1;
  canvas.width = canvas.height = side;
  const context = canvas.getContext("2d"), image = context.createImageData(side, side);
  for (let row = 0; row < side; row++) {
    for (let column = 0; column < side; column++) {
      const below = row >= middle;
      const value = below ? half[(row - middle) * columns + column] : half[(middle - row) * columns + (columns - 1 - column)];
      const at = 4 * (row * side + column), [r, g, b] = SHADES[value];
      image.data[at] = r;
      image.data[at + 1] = g;
      image.data[at + 2] = b;
      image.data[at + 3] = 255;
    }
  }
  context.putImageData(image, 0, 0);
}

const SHADES = Array.from({ length: 256 }, (_, value) => shade(value / 255));

function shade(value) {
  const place = value * (CIVIDIS.length - 1), i = Math.min(Math.floor(place), CIVIDIS.length - 2), share = place - i;
  return CIVIDIS[i].map((low, channel) => Math.round(low + share * (CIVIDIS[i + 1][channel] - low)));
}

/** A path; where the code is open it is lit. Dots mark equal steps of time, the large one its beginning. */
export function drawPath(svg, motion, bits, { dots = true } = {}) {
  const { t, x, y } = motion;
  const low = [Math.min(...x), Math.min(...y)], high = [Math.max(...x), Math.max(...y)];
  const reach = Math.max(high[0] - low[0], high[1] - low[1], 1) * 0.62;
  const centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const { width, height } = dots ? sizeOf(svg) : { width: 1, height: 1 };
  const ratio = width / height, stroke = reach / 26, at = sampler(t, x, y);
  onBackground(svg, JSON.stringify([width, height, dots, t, x, y]), (group) => {
    svg.setAttribute("viewBox", `${centre[0] - reach * ratio} ${centre[1] - reach} ${2 * reach * ratio} ${2 * reach}`);
    group.append(make("path", { class: "track", "stroke-width": stroke, d: line2(x.map((value, i) => [value, y[i]])) }));
  });
  const lit = Array.from(bits.matchAll(/1+/g), (run) => {
    const begin = run.index / bits.length, end = (run.index + run[0].length) / bits.length;
    const inner = t.map((time, i) => [time, i]).filter(([time]) => time > begin && time < end).map(([, i]) => [x[i], y[i]]);
    return line2([at(begin), ...inner, at(end)]);
  });
  if (lit.length) svg.append(make("path", { class: "lit", "stroke-width": 2.1 * stroke, d: lit.join("") }));
  if (dots) {
    const round = (r, times) => times.map((time) => at(time)).map(([cx, cy]) => `M${cx - r} ${cy}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`).join("");
    const tenths = Array.from({ length: 10 }, (_, i) => (i + 1) / 10);
    svg.append(make("path", { class: "dot", d: round(1.5 * stroke, [0]) + round(0.8 * stroke, tenths) }));
  }
}

/** A path on its photo: at its true size in the middle. */
export function drawOnPhoto(svg, motion, width, height) {
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("preserveAspectRatio", "xMidYMid meet");
  const d = line2(motion.x.map((value, i) => [width / 2 + value, height / 2 + motion.y[i]]));
  const stroke = Math.max(width, height) / 220;
  svg.replaceChildren(make("path", { class: "halo", "stroke-width": 2.2 * stroke, d }), make("path", { class: "track", "stroke-width": stroke, d }));
}

function line2(points) {
  return points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(3)} ${y.toFixed(3)}`).join("");
}

function sampler(t, x, y) {
  return (time) => {
    let i = 1;
    while (i < t.length - 1 && t[i] < time) i++;
    const share = Math.min(Math.max((time - t[i - 1]) / (t[i] - t[i - 1]), 0), 1);
    return [x[i - 1] + share * (x[i] - x[i - 1]), y[i - 1] + share * (y[i] - y[i - 1])];
  };
}

const WAYS = { snapshot: ["pin0", "best single exposure"], strobe: ["pin1", "best even pulses"], code: ["code", "best code"] };

/** Gains over the open shutter by light, as cep advise has them. */
export function drawGains(svg, advice) {
  const levels = advice.levels, light = levels.map((one) => Math.log10(one.photons));
  const gains = levels.flatMap((one) => Object.values(one.gains_db)).filter(Number.isFinite);
  const top = Math.max(1, Math.ceil(Math.max(0, ...gains))), bottom = Math.min(0, Math.floor(Math.min(0, ...gains)));
  const step = Math.max(1, Math.round((top - bottom) / 5));
  const first = Math.ceil(bottom / step) * step;
  const yTicks = Array.from({ length: Math.floor((top - first) / step) + 1 }, (_, i) => first + i * step);
  const low = light[0], high = Math.max(light.at(-1), low + 0.1);
  const place = frame(svg, {
    x: [low, high], y: [bottom, top], xTicks: [2, 3, 4, 5].filter((tick) => tick >= low && tick <= high), yTicks,
    xName: "photo-electrons at full scale", yName: "", xText: (tick) => (10 ** tick).toLocaleString("en"),
  });
  for (const [from, to] of advice.crossover) {
    const a = place.px(from === null ? low : Math.log10(from)), b = place.px(to === null ? high : Math.log10(to));
    svg.append(make("rect", { class: "pays", x: a, y: EDGE.top, width: Math.max(b - a, 0), height: place.height - EDGE.top - EDGE.bottom }));
  }
  svg.append(make("line", { class: "zero", x1: EDGE.left, x2: place.width - EDGE.right, y1: place.py(0), y2: place.py(0) }));
  const here = place.px(Math.log10(advice.photons));
  svg.append(make("line", { class: "here", x1: here, x2: here, y1: EDGE.top, y2: place.height - EDGE.bottom }));
  svg.append(make("text", { x: here + 0.4 * place.em, y: place.height - EDGE.bottom - 0.5 * place.em }, "your light"));
  const names = []; // where they stand: none covers another
  for (const [kind, [colour, name]] of Object.entries(WAYS)) {
    const points = levels.map((one, i) => [light[i], one.gains_db[kind]]).filter(([, gain]) => Number.isFinite(gain)).map(([a, b]) => [place.px(a), place.py(b)]);
    if (!points.length) continue;
    svg.append(make("path", { class: `curve ${colour}`, d: line(points) }));
    for (const [cx, cy] of points) svg.append(make("circle", { class: `marker curve ${colour}`, cx, cy, r: 3 }));
    const [x, y] = points.at(-1);
    const right = x - 0.4 * place.em, left = right - 0.55 * place.em * name.length;
    let baseline = y - 0.7 * place.em;
    while (names.some((one) => one.left < right && left < one.right && Math.abs(one.baseline - baseline) < 1.1 * place.em)) baseline += 0.3 * place.em;
    names.push({ left, right, baseline });
    svg.append(make("text", { x: right, y: baseline, "text-anchor": "end" }, name));
  }
  svg.setAttribute("aria-label", `Expected gain by light. ${advice.where}`);
}

/** What a controller's pin did, under the strip. */
export function drawPlayed(box, edges, durationNs) {
  const svg = make("svg", { viewBox: "0 0 1000 30", preserveAspectRatio: "none", role: "img", "aria-label": `${edges.length} edges as the controller played them` });
  const x = (time) => (1000 * time) / durationNs;
  let d = "M0 26", level = 0;
  for (const [time, next] of edges) {
    d += `L${x(time)} ${level ? 4 : 26}L${x(time)} ${next ? 4 : 26}`;
    level = next;
  }
  svg.append(make("path", { class: "curve code", "vector-effect": "non-scaling-stroke", d: `${d}L1000 ${level ? 4 : 26}` }));
  box.replaceChildren(svg);
  box.hidden = false;
}
