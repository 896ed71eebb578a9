// The page: what the hand changes becomes the state, the state becomes the address, and everything follows it.

import { $, put, say, sentence } from "./dom.js";
import { EDITS, mostChips, resized } from "./edits.js";
import { busyPhoto, drawEstimate, drawSharpened, hidePhoto, saveSharpened, showPhoto } from "./photo.js";
import { drawCurves, drawGains, drawMap, drawPath, drawPlayed } from "./plots.js";
import { Refused, ask, calm, complain, post, upload } from "./server.js";
import { busyShot, showShot, wireShot } from "./shot.js";
import { DEFAULTS, LIMITS, SIDES, fromAddress, isAlong, isCode, pathOf, remember, remembered, settingOf, toAddress } from "./state.js";
import { Strip } from "./strip.js";
import { digits, drawRows, noise } from "./table.js";

const page = remembered("studio-page") ?? crypto.randomUUID().replaceAll("-", "");
remember("studio-page", page);
// a page that is loaded again goes on from its last change, which its address may not have yet
const reloaded = performance.getEntriesByType("navigation")[0]?.type === "reload" ? remembered("studio-address") : null;
let state = fromAddress(reloaded ?? location.hash);
let revision = 0, shown = null, judged = null, openMap = null, job = null, known = null;
let advice = remembered("studio-advice"), estimate = remembered("studio-estimate");
let design = state.bits; // the code as the hand or a search has chosen it: a shorter motion shows fewer of its chips
let refused = null; // settings of the last verdict that was refused, and its message
const past = [], future = [];
const strip = new Strip($("strip"), (bits, done) => {
  if (done) record();
  change({ bits, search: null }, { recorded: true });
});

// -- what follows a change ------------------------------------------------------------------------------------------------

/** Run again as long as something has changed meanwhile: the latest state is the one that counts. */
function follower(run) {
  let busy = false, again = false;
  return async () => {
    again = true;
    if (busy) return;
    busy = true;
    while (again) { again = false; await run(); }
    busy = false;
  };
}

const followPicture = follower(async () => {
  const at = revision;
  try {
    const found = await post("picture", { setting: settingOf(state), ...state.search });
    calm("picture");
    if (found.error) complain(new Refused(found.error.field, found.error.message), "picture");
    shown = found;
    draw();
  } catch (error) {
    shown = null; // figures of another motion say nothing of this one
    complain(error, "picture");
  }
  document.body.toggleAttribute("data-blank", !shown);
  document.body.dataset.picture = at;
});

/** The verdict, where it is one of the motion, light and limits of now. */
function verdictNow() {
  return judged?.key === adviceKey() ? judged : null;
}

/** Expected PSNR of the code and of the open shutter: at once for a path that is known; one that may be off is judged
 *  once the hand rests, until then null. */
function ownPsnr() {
  if (!shown) return null;
  if (!state.path_error) return { psnr_db: shown.figures.psnr_db, open_psnr_db: shown.open.psnr_db };
  return verdictNow()?.bits === state.bits ? judged : null;
}

/** Bits of a side of the comparison; null while the best single exposure is being looked for. */
function sideBits(side) {
  if (side === "code") return state.bits;
  if (side === "open") return "1".repeat(state.bits.length);
  return verdictNow()?.ways.find((way) => way.kind === "snapshot")?.bits ?? null;
}

const taken = {}; // the last photo of each side's code
const followPhotos = follower(async () => {
  const at = revision, { left, right, view, photo } = state;
  const { path_error, ...setting } = settingOf(state);
  const codes = {}, keys = {};
  for (const side of new Set([left, right])) {
    const bits = sideBits(side);
    keys[side] = JSON.stringify({ ...setting, bits, view, photo });
    if (bits !== null && taken[side]?.key !== keys[side]) codes[side] = bits;
  }
  try {
    if (Object.keys(codes).length) {
      const found = await post("photos", { setting: settingOf(state), restored: view === "restored", scene: photo, codes });
      for (const side of Object.keys(codes)) taken[side] = { key: keys[side], image: found[side] };
    }
    calm("photos");
    await Promise.all([showSide("left", left), showSide("right", right)]);
  } catch (error) { complain(error, "photos"); }
  document.body.dataset.photo = at;
});

async function showSide(place, side) {
  const image = $(`photo-${place}`), source = taken[side]?.image, words = `${SIDES[side]}, ${state.view === "restored" ? "restored" : "as taken"}`;
  say(`tag-${place}`, sideBits(side) === null ? `${SIDES[side]}: being looked for` : SIDES[side]);
  image.alt = `Simulated photo, ${words}`;
  if (!source || image.src === source) return;
  image.src = source;
  await image.decode().catch(() => {});
}

const followVerdict = follower(async () => {
  const at = revision, key = adviceKey();
  try {
    judged = { ...await post("verdict", { setting: settingOf(state) }), key, bits: state.bits };
    refused = null;
    calm("verdict");
  } catch (error) {
    judged = null;
    refused = key;
    complain(error, "verdict");
  }
  document.body.dataset.verdict = at;
  drawVerdict();
  drawFacts();
  drawPins();
  if (state.left === "snapshot" || state.right === "snapshot") followPhotos();
});

/** First what to do, by the best code that was found at this light; then where it turns; then what this code is worth.
 *  Nothing is said to do before that code was searched: without it the advice may be the opposite. */
function drawVerdict() {
  const key = adviceKey(), valid = advice?.key === key;
  $("sentence").classList.toggle("stale", !valid);
  $("gains").classList.toggle("stale", !valid);
  if (valid) {
    say("sentence", `${advice.recommendation}.`);
    say("where", `${advice.where} ${advice.conditions}`);
  } else {
    const waits = job?.state === "running" ? JOBS[job.kind].waits : null;
    const searching = waits ?? "Searching the best exposure for this motion and light…";
    say("sentence", refused === key ? "No verdict: one of the inputs below needs a look." : searching);
    say("where", job?.state === "running" && job.kind === "advise" ? `${Math.round(100 * job.share)} %` : "");
  }
  say("own", verdictNow() ? ownLine(valid) : "");
  $("own").classList.toggle("stale", document.body.dataset.verdict !== document.body.dataset.asked);
  const doubts = estimate?.paths.some((path) => isAlong(state.motion, path)) ? estimate.doubts ?? [] : [];
  $("doubt").hidden = !doubts.length;
  say("doubt", doubts.map(sentence).join(" "));
}

function ownLine(valid) {
  const single = (valid && advice.ways.snapshot) || judged.ways.find((way) => way.kind === "snapshot" && way.within_limits && !way.saturates);
  const beside = single ? [[single.psnr_db, "the best single exposure"]] : [];
  if (valid && advice.ways.code) beside.push([advice.ways.code.psnr_db, "the best code found"]);
  const gaps = beside.map(([psnr, name]) => {
    const gap = judged.psnr_db - psnr;
    return Math.abs(gap) < 0.005 ? `as well as ${name}` : `about ${Math.abs(gap).toFixed(2)} dB ${gap > 0 ? "better" : "worse"} than ${name}`;
  });
  return gaps.length ? `The code below restores ${gaps.join(" and ")}.` : "";
}

let pinned = new Map(), restTimer = null; // figures of the pinned codes by their names
const followPins = follower(async () => {
  try {
    const pins = Object.fromEntries(state.pins.filter((pin) => pin.bits.length === state.bits.length).map((pin) => [pin.name, pin.bits]));
    pinned = new Map(Object.keys(pins).length ? Object.entries((await post("compare", { setting: settingOf(state), pins })).pins) : []);
    calm("pins");
  } catch (error) { complain(error, "pins"); }
  drawPins();
  drawCurve();
});

let adviceTimer = null, adviceAsked = "";
function adviceKey() {
  const { bits, ...rest } = settingOf(state);
  return JSON.stringify({ ...rest, chips: bits.length });
}

function followAdvice() {
  clearTimeout(adviceTimer);
  const key = adviceKey();
  if (key === adviceAsked || key === advice?.key) return;
  adviceTimer = setTimeout(async () => {
    if (beginning || (job?.state === "running" && job.kind !== "advise")) return; // after it
    adviceAsked = key;
    try {
      await post("job", { page, kind: "advise", setting: settingOf(state) });
    } catch (error) {
      adviceAsked = "";
      if (error.field !== "job") complain(error, "verdict");
    }
  }, 900);
}

function change(part, { recorded = false } = {}) {
  if (!recorded) record();
  const before = state;
  state = { ...state, ...part };
  if (part.bits) design = part.bits;
  else if (part.motion) {
    const bits = resized(design, Math.min(design.length, mostChips(state.motion)));
    if (bits.length !== state.bits.length) state = { ...state, bits, open: null, search: null };
  }
  keepAddress();
  if (before.bits !== state.bits || before.exposure !== state.exposure) $("played").hidden = true; // of another code
  fill();
  const isOther = JSON.stringify(settingOf(before)) !== JSON.stringify(settingOf(state));
  if (isOther || ["photo", "view", "left", "right"].some((name) => before[name] !== state[name])) follow();
  else followPins();
}

// The address follows once the hand rests: a new one makes browsers style the whole page anew, and they stop a page that
// writes it more than 200 times in 10 s.
let addressTimer = null, written = location.hash;
function keepAddress() {
  clearTimeout(addressTimer);
  addressTimer = setTimeout(writeAddress, 300);
  remember("studio-address", toAddress(state));
  document.body.dataset.address = "late";
}

function writeAddress() {
  clearTimeout(addressTimer);
  addressTimer = null;
  delete document.body.dataset.address;
  if (location.hash !== written) return; // somebody has just typed another one
  history.replaceState(null, "", toAddress(state));
  written = location.hash;
}

function follow() {
  if (!isCode(state.bits)) {
    complain(new Refused("bits", "a code is a row of 1 (open) and 0 (closed), of up to 512 chips, with at least one open"), "picture");
    return;
  }
  document.body.dataset.asked = ++revision;
  followPicture();
  followPhotos();
  drawVerdict();
  clearTimeout(restTimer);
  restTimer = setTimeout(followVerdict, 250); // once the hand rests: pictures go first
  if (state.pins.length) followPins();
  followAdvice();
}

function record() {
  past.push(state);
  if (past.length > 200) past.shift();
  future.length = 0;
}

function travel(from, to) {
  if (!from.length) return;
  to.push(state);
  change(from.pop(), { recorded: true });
}

// -- what is shown ----------------------------------------------------------------------------------------------------------

/** Put the state into the fields; one that is being typed in is left alone. */
function fill() {
  strip.set(isCode(state.bits) ? state.bits : "1");
  put("bits", state.bits);
  put("chips", state.bits.length);
  for (const name of ["exposure", "camera", "device"]) put(name, state[name]);
  const camera = known?.cameras.find((one) => one.name === state.camera);
  put("photons", state.photons ?? camera?.photons ?? 10000);
  put("photons-range", Math.log10(state.photons ?? camera?.photons ?? 10000));
  put("read_noise", state.read_noise ?? camera?.read_noise ?? 5);
  say("camera-about", camera?.about ?? "a sensor of 12 bits");
  say("device-about", known?.devices.find((one) => one.name === state.device)?.about ?? "");
  put("open-low", state.open?.[0] ?? "");
  put("open-high", state.open?.[1] ?? "");
  for (const name of LIMITS) put(name, state[name] ?? "");
  const { motion } = state;
  $("motion-kind").querySelector('[value="path"]').disabled = motion.kind !== "path" && !estimate;
  put("motion-kind", motion.kind === "example" ? `example:${motion.name}` : motion.kind);
  $("straight-fields").hidden = motion.kind !== "straight";
  if (motion.kind === "straight") {
    for (const name of ["length", "angle"]) { put(name, motion[name]); put(`${name}-range`, motion[name]); }
  }
  put("path_error", state.path_error ?? "");
  for (const radio of document.getElementsByName("view")) radio.checked = radio.value === state.view;
  for (const side of ["left", "right"]) put(`side-${side}`, state[side]);
  $("undo").disabled = !past.length;
  $("redo").disabled = !future.length;
  say("photo-line", state.view === "restored"
    ? "Restored by a Wiener filter along the path as it is drawn: any error of it comes on top."
    : "With the camera's noise. Coded photos are brightened to the light of the open shutter.");
  drawEstimate(estimate, state, (path) => change({ motion: pathOf(path) }));
}

function draw() {
  const { code, motion, figures, open } = shown;
  say("code-line", `${code.open} of ${code.chips} chips open, ${code.openings} opening${code.openings === 1 ? "" : "s"}, chips of ${code.chip}`);
  say("axis-middle", half(code.exposure));
  say("axis-end", code.exposure);
  $("broken").hidden = !code.broken.length;
  say("broken", code.broken.map(sentence).join(" "));
  drawFacts();
  const zero = figures.min_mtf_lower < 1e-6;
  const unproven = zero && figures.min_mtf > 1e-4;
  figure("min", zero ? "0" : `≥ ${digits(figures.min_mtf_lower)}`,
    unproven ? `reached ${digits(figures.min_mtf)}; not proven above 0` : `open shutter ${digits(open.min_mtf)}`);
  figure("noise", `${noise(figures.noise_gain_db)} dB`, `open shutter ${noise(open.noise_gain_db)} dB`);
  figure("light", `${Math.round(100 * code.duty)} %`, `${code.open} / ${code.chips}`);
  const isKnown = motion.direction === "known";
  const direction = motion.both ? "direction unknown: the worse one counts" : isKnown ? "direction known" : "either direction is the same";
  say("path-line", `${motion.length_px.toFixed(1)} px long, ${motion.extent_px.toFixed(1)} px wide; ${direction}.`
    + " Lit where the shutter is open; dots are equal steps of time.");
  drawPath($("path"), motion.path, state.bits);
  drawCurve();
  drawMap($("map-code"), shown.map);
  if (shown.open_map.db !== openMap) drawMap($("map-open"), shown.open_map);
  openMap = shown.open_map.db;
  $("map-code").setAttribute("aria-label", "MTF of this code over all frequencies");
  $("map-open").setAttribute("aria-label", "MTF of the open shutter over all frequencies");
  say("commands", shown.commands.join("\n"));
  drawPins();
}

/** The expected PSNR. */
function drawFacts() {
  if (!shown) return;
  const own = ownPsnr();
  if (own) figure("psnr", `${own.psnr_db.toFixed(2)} dB`, `${signed(own.psnr_db - own.open_psnr_db)} dB over the open shutter`);
  else figure("psnr", "…", "with the path's error");
}

function figure(name, value, delta) {
  say(`f-${name}`, value);
  say(`d-${name}`, delta);
}

function drawCurve() {
  if (!shown) return;
  const pins = state.pins.filter((pin) => pinned.has(pin.name)).map((pin, i) => ({ values: pinned.get(pin.name).curve, class: `pin${i % 5}` }));
  drawCurves($("curve"), [{ values: shown.open_curve, class: "open" }, ...pins, { values: shown.curve, class: "code" }]);
}

function drawPins() {
  if (!shown) return;
  const figures = { ...shown.figures, psnr_db: ownPsnr()?.psnr_db ?? null };
  const rows = [{ name: "this code", bits: state.bits, figures, acts: [] }];
  for (const pin of state.pins) rows.push({ ...pin, figures: pinned.get(pin.name), acts: ["take", "unpin"] });
  const exposures = [...(judged?.ways ?? [])];
  if (advice?.key === adviceKey() && advice.ways.code) exposures.push({ ...advice.ways.code, name: "best code found" });
  for (const { name, bits, psnr_db, saturates, within_limits } of exposures) {
    const note = saturates ? "saturates" : within_limits ? "" : "outside the limits";
    rows.push({ name, bits, figures: { psnr_db }, note, acts: ["take", "pin"] });
  }
  drawRows($("pins").tBodies[0], rows, {
    take: ({ bits }) => change({ bits, search: null }),
    pin: ({ name, bits }) => pinCode(name, bits),
    unpin: ({ name }) => change({ pins: state.pins.filter((pin) => pin.name !== name) }),
  });
}

const signed = (x) => `${x >= 0 ? "+" : "−"}${Math.abs(x).toFixed(2)}`;
const half = (text) => { const [number, unit] = text.split(" "); return `${(Number(number) / 2).toPrecision(3)} ${unit}`; };

// -- the job --------------------------------------------------------------------------------------------------------------

function listen() {
  const source = new EventSource(`/api/events?page=${page}`);
  source.onmessage = (event) => heard(JSON.parse(event.data));
}

// what the page says of each kind, where the verdict stands meanwhile, and what follows
const JOBS = {
  calibrate: { note: "Estimating the motion", waits: "The verdict follows when the motion of the photo is found.", done: calibrated },
  search: { note: "Searching", waits: "The verdict follows when the search is done.", done: searched },
  play: { note: "Uploading", waits: "The verdict follows when the code is played.", done: played },
  sharpen: { note: "Sharpening", waits: "The verdict follows when the photo is sharpened.", done: sharpened },
  shoot: { note: "Taking the photo", waits: "The verdict follows when the photo is taken.", done: keepShot },
  advise: { done: advised },
};
let handled = remembered("studio-handled") ?? 0;
function heard(news) {
  job = news;
  const running = news?.state === "running";
  const mine = running && news.kind !== "advise";
  const ofPhoto = mine && (news.kind === "calibrate" || news.kind === "sharpen"); // shown where the photo is
  const ofShot = mine && news.kind === "shoot"; // and this in its card
  $("job").hidden = !mine || ofPhoto || ofShot;
  $("stop").hidden = !mine || ofPhoto || ofShot;
  $("search").hidden = mine;
  $("stop").textContent = news?.kind === "search" ? "Stop, keep the best" : "Cancel";
  busyPhoto(ofPhoto ? news : null);
  busyShot(ofShot ? news : null);
  if (running && advice?.key !== adviceKey()) drawVerdict(); // it waits for this work
  if (!news) return;
  const note = mine ? `${JOBS[news.kind].note}${news.note ? `: ${news.note}` : ""}` : "";
  $(ofPhoto ? "drop-share" : "job-share").value = news.share;
  $(ofPhoto ? "drop-note" : "job-note").textContent = note;
  const better = running && news.kind === "search" ? news.best.bits : null;
  if (better && better !== state.bits) change({ bits: better, search: null }, { recorded: true });
  if (running && news.kind === "calibrate" && news.best.preview) showPhoto(`/api/photo/${state.photo}`);
  if (news.kind === "shoot" && news.best.photo) keepShot(running ? news.best : { ...news.best, ...news.result });
  if (running || news.number <= handled) return;
  handled = news.number;
  remember("studio-handled", handled);
  if (news.state === "failed") {
    if (news.kind === "advise") { refused = adviceAsked; drawVerdict(); }
    complain(new Refused(news.error.field, news.error.message), "job");
    return;
  }
  calm("job");
  if (news.state === "done") JOBS[news.kind].done(news.result);
  if (news.kind !== "advise") { adviceAsked = ""; followAdvice(); }
}

function searched(found) {
  change({ bits: found.bits, search: found.stopped === "steps" ? { steps: found.steps, seed: found.seed } : null }, { recorded: true });
  $("job-note").textContent = "";
}

function calibrated(found) {
  estimate = found;
  remember("studio-estimate", estimate);
  change({ motion: pathOf(found.paths[0]), path_error: found.path_error ?? null });
}

function sharpened(found) {
  estimate = { ...estimate, sharp: { ...found, ready: true } };
  remember("studio-estimate", estimate);
  showPhoto(`/api/photo/${state.photo}/sharpened`);
  drawSharpened(estimate, state.photo);
  saveSharpened(state.photo);
}

function advised(found) {
  if (adviceAsked !== adviceKey()) return; // of a setting that has changed since
  advice = { ...found, key: adviceAsked };
  remember("studio-advice", advice);
  showAdvice();
  drawVerdict();
  drawPins();
}

function showAdvice() {
  $("gains-line").textContent = advice.crossover.length ? "Shaded: a code pays." : "A code pays at none of these.";
  drawGains($("gains"), advice);
}

function played(found) {
  const said = [`${found.port}: ${found.meaning}${found.armed ? `, armed for ${found.lease_ms} ms` : ""}.`, ...found.warnings.map(sentence)];
  if (found.edges_ns.length) {
    said.push(`Its ${found.edges_ns.length} edges as played are under the strip.`);
    drawPlayed($("played"), found.edges_ns, found.duration_ns);
    $("played").scrollIntoView({ block: "center" }); // with the strip above it
  }
  $("play-line").textContent = said.map(sentence).join(" ");
}

function keepShot(found) {
  remember("studio-shot-photo", found);
  showShot(found);
}

let beginning = false; // a job is asked for and not heard of yet
async function begin(kind, more = {}) {
  calm("job");
  beginning = true;
  const ofPhoto = kind === "calibrate" || kind === "sharpen";
  const ofShot = kind === "shoot";
  $("job").hidden = ofPhoto || ofShot;
  if (ofPhoto) busyPhoto({ share: 0 });
  if (ofShot) busyShot({ share: 0, note: "starting" });
  $(ofPhoto ? "drop-note" : "job-note").textContent = "starting";
  try {
    const begun = await post("job", { page, kind, setting: settingOf(state), ...more });
    if (job?.number !== begun.number) job = begun;
  } catch (error) {
    $("job").hidden = true;
    busyPhoto(null);
    busyShot(null);
    complain(error, "job");
    adviceAsked = "";
    setTimeout(followAdvice);
  } finally {
    beginning = false;
  }
}

// -- photos, files ----------------------------------------------------------------------------------------------------------

async function takePhoto(file) {
  calm("photo");
  estimate = null;
  showPhoto(URL.createObjectURL(file));
  busyPhoto({ share: 0 });
  $("drop-note").textContent = "reading the photo";
  try {
    const suffix = /\.[a-z0-9]+$/i.exec(file.name)?.[0] ?? ""; // a RAW file is known by its name alone
    const { photo } = await upload(`photo?suffix=${encodeURIComponent(suffix)}`, file);
    change({ photo });
    await begin("calibrate", { photo });
  } catch (error) {
    hidePhoto();
    busyPhoto(null);
    complain(error, "photo");
  }
}

async function openFile(file) {
  calm("file");
  try {
    const found = await upload("document", file);
    if (found.state) change({ ...structuredClone(DEFAULTS), ...found.state });
    if (found.bits) change({ bits: found.bits, exposure: found.exposure, device: found.device ?? state.device, search: null });
    if (found.warning) complain(new Refused("open_file", found.warning), "file");
    if (found.paths) takePaths(found);
  } catch (error) { complain(error, "file"); }
}

async function openGyro(file) {
  calm("gyro");
  const query = new URLSearchParams(["focal", "start", "exposure", "axes"].map((name) => [name, $(`gyro_${name}`).value]));
  try {
    takePaths(await upload(`gyro?${query}`, file));
  } catch (error) { complain(error, "gyro"); }
}

function takePaths(found) {
  estimate = { paths: found.paths, path_error: found.path_error, warnings: found.warnings ?? [] };
  remember("studio-estimate", estimate);
  hidePhoto();
  change({ motion: pathOf(found.paths[0]), path_error: found.path_error ?? null, photo: "" });
}

function download(name, text, kind = "text/plain") {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: kind }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// -- hands ------------------------------------------------------------------------------------------------------------------

const number = (id) => ($(id).value.trim() === "" ? null : Number($(id).value));
const stopper = (by) => () => post("stop", { page }).catch((error) => complain(error, by));
const on = (id, event, does) => $(id).addEventListener(event, does);

function pinCode(name, bits) {
  if (state.pins.some((pin) => pin.bits === bits)) return; // once is enough
  let free = name;
  for (let i = 2; state.pins.some((pin) => pin.name === free); i++) free = `${name} ${i}`;
  change({ pins: [...state.pins, { name: free.replaceAll("=", " "), bits }].slice(-10) });
}

function wire() {
  document.querySelector(".skip").addEventListener("click", (event) => {
    event.preventDefault(); // the address holds the state
    (document.querySelector("#strip [tabindex='0']") ?? document.querySelector("#strip button")).focus();
  });
  on("chips", "change", () => change({ bits: resized(state.bits, number("chips")), open: null, search: null }));
  on("bits", "input", () => { const bits = $("bits").value.replace(/\s/g, ""); change({ bits, search: null }); });
  for (const [id, edit] of Object.entries(EDITS)) on(id, "click", () => change({ bits: edit(state.bits), search: null }));
  on("undo", "click", () => travel(past, future));
  on("redo", "click", () => travel(future, past));
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || event.target.matches("input, textarea")) return;
    event.preventDefault();
    if (event.shiftKey) travel(future, past); else travel(past, future);
  });
  on("published", "change", () => {
    const found = known.published.find((one) => one.name === $("published").value);
    $("published").value = "";
    if (found) change({ bits: found.bits, open: null, search: null });
  });
  on("pin", "click", () => pinCode(known.published.find((one) => one.bits === state.bits)?.name ?? `code ${state.pins.length + 1}`, state.bits));
  for (const name of ["length", "angle"]) {
    for (const id of [name, `${name}-range`]) on(id, "input", () => change({ motion: { ...state.motion, [name]: number(id) } }));
  }
  on("motion-kind", "change", () => {
    const [kind, name] = $("motion-kind").value.split(":");
    const length = shown ? Math.round(shown.motion.length_px) : 40;
    if (kind === "straight") change({ motion: { kind, length, angle: 0 }, path_error: null });
    else if (kind === "example") change({ motion: { kind, name }, path_error: null });
    else if (estimate) change({ motion: pathOf(estimate.paths[0]), path_error: estimate.path_error ?? null });
  });
  on("camera", "change", () => change({ camera: $("camera").value, photons: null, read_noise: null }));
  on("photons", "input", () => change({ photons: number("photons") }));
  on("photons-range", "input", () => change({ photons: Number((10 ** number("photons-range")).toPrecision(3)) }));
  on("path_error", "change", () => change({ path_error: number("path_error") })); // a verdict with an error takes seconds
  on("read_noise", "input", () => change({ read_noise: number("read_noise") }));
  on("exposure", "input", () => change({ exposure: $("exposure").value.trim() }));
  on("device", "change", () => change({ device: $("device").value }));
  for (const id of ["open-low", "open-high"]) on(id, "input", () => {
    const low = number("open-low"), high = number("open-high");
    change({ open: low === null && high === null ? null : [low ?? 1, high ?? state.bits.length] });
  });
  for (const name of LIMITS) on(name, "input", () => change({ [name]: number(name) }));
  for (const radio of document.getElementsByName("view")) radio.addEventListener("change", () => change({ view: radio.value }));
  for (const side of ["left", "right"]) {
    $(`side-${side}`).replaceChildren(...Object.entries(SIDES).map(([name, text]) => new Option(text, name)));
    on(`side-${side}`, "change", () => change({ [side]: $(`side-${side}`).value }));
  }
  on("divider", "input", () => {
    const share = number("divider");
    $("compare").style.setProperty("--at", `${share}%`);
    $("divider").setAttribute("aria-valuetext", `${share} percent from the left`);
  });
  on("search", "click", () => { record(); begin("search", { steps: Number($("effort").value), seed: 0 }); });
  on("stop", "click", stopper("job"));
  on("photo-file", "change", () => { if ($("photo-file").files[0]) takePhoto($("photo-file").files[0]); $("photo-file").value = ""; });
  on("try", "click", async () => {
    calm("photo");
    try {
      const { photo } = await ask("/api/example-photo", { method: "POST" });
      estimate = null;
      change({ photo });
      await begin("calibrate", { photo });
    } catch (error) { complain(error, "photo"); }
  });
  on("drop-stop", "click", stopper("photo"));
  on("sharpen", "click", () => { if (estimate.sharp?.ready) saveSharpened(state.photo); else begin("sharpen", { photo: state.photo, anyway: estimate.kept === true }); });
  on("sharpened-view", "click", () => {
    const seen = $("photo-image").src.endsWith("/sharpened");
    showPhoto(`/api/photo/${state.photo}${seen ? "" : "/sharpened"}`);
    drawSharpened(estimate, state.photo);
  });
  on("gyro-file", "change", () => { if ($("gyro-file").files[0]) openGyro($("gyro-file").files[0]); });
  on("open_file", "change", () => { if ($("open_file").files[0]) openFile($("open_file").files[0]); $("open_file").value = ""; });
  const drop = $("drop");
  for (const name of ["dragenter", "dragover"]) document.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
  document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) drop.classList.remove("over"); });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    const [file] = event.dataTransfer.files;
    if (!file) return;
    if (/\.json$/i.test(file.name)) openFile(file);
    else if (/\.(csv|tsv|txt)$/i.test(file.name)) openGyro(file);
    else takePhoto(file);
  });
  on("export", "click", async () => {
    try {
      const { name, text, warnings } = await post("export", { setting: settingOf(state), format: $("format").value });
      calm("format");
      download(name, text);
      if (warnings.length) complain(new Refused("format", `${name}: ${warnings.join("; ")}`), "format");
    } catch (error) { complain(error, "format"); }
  });
  on("play", "click", () => { calm("port"); begin("play", { port: $("port").value, arm: true }); });
  for (const id of ["port", "shot_port"]) on(id, "focus", async () => {
    const { ports } = await ask("/api/ports").catch(() => ({ ports: [] }));
    const chosen = $(id).value;
    $(id).replaceChildren(new Option("emulated Uno", "emulated"), ...ports.map((one) => new Option(one.name, one.name)));
    $(id).value = [...$(id).options].some((one) => one.value === chosen) ? chosen : "emulated";
  });
  wireShot({ begin: (order) => begin("shoot", order), stop: stopper("job") });
  on("save", "click", async () => {
    try {
      const document = await post("save", { setting: settingOf(state), state });
      download("studio.json", `${JSON.stringify(document, null, 1)}\n`, "application/json");
    } catch (error) { complain(error, "file"); }
  });
  on("copy", "click", async () => {
    writeAddress();
    await navigator.clipboard?.writeText(location.href).catch(() => {});
    $("copy").textContent = "Copied";
    setTimeout(() => { $("copy").textContent = "Copy address"; }, 1200);
  });
  addEventListener("hashchange", () => {
    written = location.hash;
    remember("studio-address", written);
    state = fromAddress(location.hash);
    design = state.bits;
    fill();
    follow();
  });
  let resizing = 0;
  addEventListener("resize", () => {
    cancelAnimationFrame(resizing);
    resizing = requestAnimationFrame(() => { if (shown) draw(); if (advice) showAdvice(); });
  });
}

async function start() {
  for (const term of document.querySelectorAll(".term")) term.setAttribute("aria-description", term.dataset.tip);
  wire();
  fill();
  listen(); // first: a job ends whose page does not listen
  if (state.photo) showPhoto(`/api/photo/${state.photo}`);
  follow();
  known = await ask("/api/start");
  const opened = await ask("/api/opened").catch(() => ({}));
  $("camera").replaceChildren(new Option("standard, 12 bit", ""), ...known.cameras.map((one) => new Option(one.name, one.name)));
  $("device").append(...known.devices.map((one) => new Option(one.name, one.name)));
  $("format").replaceChildren(...known.formats.map((one) => new Option(`${one.name}: ${one.about}`, one.name)));
  $("shot-kinds").replaceChildren(...known.kinds.map((one) => new Option(one.about, `${one.name}:`)));
  $("published").append(...known.published.map((one) => new Option(`${one.name} (${one.bits.length})`, one.name)));
  for (const one of known.examples) $("motion-kind").append(new Option(`example: ${one.about}`, `example:${one.name}`));
  if (opened.state && !location.hash) state = { ...structuredClone(DEFAULTS), ...opened.state };
  design = state.bits;
  if (advice) showAdvice();
  change({}, { recorded: true });
}

start().catch((error) => complain(error instanceof Refused ? error : new Refused("page", String(error))));
