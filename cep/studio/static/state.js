// The state of the page: plain values, written into the address after #, so that the address is the state.

export const DEFAULTS = {
  motion: { kind: "straight", length: 40, angle: 0 },
  bits: "1010000111000001010000110011110111010111001001100111",
  exposure: "1/30",
  camera: "aptina-mt9m031-8bit",
  photons: null,
  read_noise: null,
  device: "",
  path_error: null,
  open: null,
  min_open: null, min_closed: null,
  pins: [],
  photo: "",
  view: "taken",
  left: "open",
  right: "code",
  search: null,
};
const VIEWS = ["view", "left", "right"]; // of the photos
export const LIMITS = ["min_open", "min_closed"];
const NUMBERS = ["path_error", "photons", "read_noise", ...LIMITS];
const MOST_CHIPS = 512, MOST_SAMPLES = 512;
export const SIDES = { open: "open shutter", snapshot: "best single exposure", code: "this code" };

/** Whether a text is a code with an open chip, of a length that the studio takes. */
export const isCode = (text) => text.length <= MOST_CHIPS && /^[01]*1[01]*$/.test(text);

/** What the server reads: the setting alone, without what only the page needs. */
export function settingOf(state) {
  const { motion, path_error, bits, exposure, camera, photons, read_noise, device, open } = state;
  const limits = Object.fromEntries(LIMITS.filter((name) => state[name] !== null).map((name) => [name, state[name]]));
  return { motion, path_error, bits, exposure, camera, photons, read_noise, device, open, ...limits };
}

export function toAddress(state) {
  const query = new URLSearchParams();
  query.set("motion", motionText(state.motion));
  query.set("code", state.bits);
  for (const name of ["exposure", "camera", "device"]) if (state[name] !== DEFAULTS[name]) query.set(name, state[name]);
  for (const name of NUMBERS) if (state[name] !== null) query.set(name, state[name]);
  if (state.open) query.set("open", state.open.join(":"));
  for (const pin of state.pins) query.append("pin", `${pin.name}=${pin.bits}`);
  if (state.photo) query.set("photo", state.photo);
  for (const name of VIEWS) if (state[name] !== DEFAULTS[name]) query.set(name, state[name]);
  if (state.search) query.set("search", `${state.search.steps}:${state.search.seed}`);
  return `#${query.toString().replaceAll("%3A", ":").replaceAll("%2F", "/").replaceAll("%3D", "=")}`;
}

export function fromAddress(hash) {
  const query = new URLSearchParams(hash.replace(/^#/, ""));
  const state = structuredClone(DEFAULTS);
  if (query.has("motion")) state.motion = motionOf(query.get("motion"));
  if (query.has("code")) state.bits = query.get("code");
  for (const name of ["exposure", "camera", "device", "photo", ...VIEWS]) if (query.has(name)) state[name] = query.get(name);
  for (const side of ["left", "right"]) if (!Object.hasOwn(SIDES, state[side])) state[side] = DEFAULTS[side];
  for (const name of NUMBERS) if (query.has(name) && query.get(name) !== "") state[name] = numberOf(query.get(name));
  if (query.has("open")) {
    const ends = query.get("open").split(":").map(numberOf);
    state.open = ends.length === 1 ? [ends[0], ends[0]] : ends;
  }
  state.pins = query.getAll("pin").map((text) => ({ name: text.slice(0, text.lastIndexOf("=")), bits: text.slice(text.lastIndexOf("=") + 1) }))
    .filter((pin) => isCode(pin.bits)).slice(0, 10);
  if (query.has("search")) {
    const [steps, seed] = query.get("search").split(":").map(Number);
    if (Number.isInteger(steps) && Number.isInteger(seed)) state.search = { steps, seed };
  }
  return state;
}

/** A number, or the text where it is none: JSON has no NaN, and the server would take what it sends instead for nothing. */
function numberOf(text) {
  return Number.isFinite(Number(text)) ? Number(text) : text;
}

// -- motions: straight:40:0, example:walk, or path:direction:scale:base64 of 16-bit t, x and y ---------------------------

function motionText(motion) {
  if (motion.kind === "unreadable") return motion.text;
  if (motion.kind === "straight") return `straight:${motion.length}:${motion.angle}`;
  if (motion.kind === "example") return `example:${motion.name}`;
  const { scale, bytes } = packed(motion);
  return `path:${motion.direction}:${scale}:${base64(bytes)}`;
}

function motionOf(text) {
  const [kind, ...rest] = text.split(":");
  if (kind === "straight") return { kind, length: numberOf(rest[0] ?? ""), angle: numberOf(rest[1] ?? "0") };
  if (kind === "example") return { kind, name: rest[0] ?? "" };
  const bytes = kind === "path" && rest.length === 3 ? bytesOf(rest[2]) : [];
  const count = bytes.length / 6, scale = Number(rest[1]);
  if (!Number.isInteger(count) || count < 2 || count > MOST_SAMPLES || !Number.isFinite(scale)) return { kind: "unreadable", text };
  return unpacked(rest[0], scale, bytes);
}

function bytesOf(text) {
  try {
    return Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (letter) => letter.charCodeAt(0));
  } catch {
    return [];
  }
}

/** A path as it comes back out of the address: what is measured is what the address says. */
export function pathOf(path) {
  const { scale, bytes } = packed(path);
  return unpacked(path.direction, scale, bytes);
}

/** Whether a motion is along a path of an estimate. */
export const isAlong = (motion, path) => motion.kind === "path" && JSON.stringify(motion.x) === JSON.stringify(pathOf(path).x);

function packed({ t, x, y }) {
  const reach = Math.max(...x.map(Math.abs), ...y.map(Math.abs), 1e-6);
  const scale = Number((reach / 32000).toPrecision(4)) || 1e-6;
  const view = new DataView(new ArrayBuffer(6 * t.length));
  t.forEach((value, i) => view.setUint16(2 * i, Math.round(65535 * value)));
  x.forEach((value, i) => view.setInt16(2 * (t.length + i), Math.round(value / scale)));
  y.forEach((value, i) => view.setInt16(2 * (2 * t.length + i), Math.round(value / scale)));
  return { scale, bytes: new Uint8Array(view.buffer) };
}

function unpacked(direction, scale, bytes) {
  const count = bytes.length / 6, view = new DataView(bytes.buffer);
  const read = (at, get, size) => Array.from({ length: count }, (_, i) => get.call(view, 2 * (at * count + i)) * size);
  return {
    kind: "path", direction,
    t: read(0, view.getUint16, 1 / 65535), x: read(1, view.getInt16, scale), y: read(2, view.getInt16, scale),
  };
}

function base64(bytes) {
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

// -- memory of this tab -----------------------------------------------------------------------------------------------------

export function remembered(name) {
  try { return JSON.parse(sessionStorage.getItem(name)); } catch { return null; }
}

export function remember(name, value) {
  try { sessionStorage.setItem(name, JSON.stringify(value)); } catch { /* it is only a comfort */ }
}
