// The card that takes a photo with a camera: its fields, the last frame with its histogram, the restored photo, the verdict.

import { $, holding, sentence } from "./dom.js";
import { drawHistogram } from "./plots.js";
import { remember, remembered } from "./state.js";

const FIELDS = ["shot_camera", "shot_port", "shot_release"];
let photo = null; // the last one, as it is shown

/** Wire the card: `begin` asks for the job with its fields, `stop` ends it. */
export function wireShot({ begin, stop }) {
  const before = remembered("studio-shot") ?? {};
  for (const field of FIELDS) {
    if (before[field] !== undefined) $(field).value = before[field];
    $(field).addEventListener("change", () => remember("studio-shot", Object.fromEntries(FIELDS.map((name) => [name, $(name).value]))));
  }
  const shoot = () => {
    if (!$("shoot").disabled) begin({ camera: $("shot_camera").value.trim(), port: $("shot_port").value, release: $("shot_release").value });
  };
  $("shoot").addEventListener("click", shoot);
  $("shot_camera").addEventListener("keydown", (event) => { if (event.key === "Enter") shoot(); });
  $("shot-stop").addEventListener("click", stop);
  $("to-shot").addEventListener("click", () => {
    $("shot").scrollIntoView({ block: "start" });
    $("shoot").focus({ preventScroll: true });
  });
  addEventListener("resize", () => requestAnimationFrame(() => { if (photo) drawHistogram($("shot-histogram"), photo.histogram, photo.clipped); }));
  const last = remembered("studio-shot-photo");
  if (last) showShot(last);
}

/** Show how far the job is; null when none takes a photo. */
export function busyShot(news) {
  $("shot-job").hidden = !news;
  $("shot-stop").hidden = !news;
  $("shoot").disabled = Boolean(news);
  if (!news) return;
  $("shot-share").value = news.share;
  $("shot-note").textContent = news.note;
}

/** Show a photo: first what to do about the light, where it counts; else why it does not. */
export function showShot(found) {
  photo = found;
  const first = found.counts ? found.advice : `take it again: the photo ${found.verdict}`;
  $("shot-sentence").textContent = sentence(first);
  $("shot-sentence").classList.toggle("bad", found.is_clipped || !found.counts);
  $("shot-shown").hidden = false;
  $("shot-photo").onerror = () => { $("shot-shown").hidden = true; photo = null; };
  $("shot-photo").src = `/api/photo/${found.photo}`;
  $("shot-restored-box").hidden = !found.restored;
  if (found.restored) $("shot-restored").src = `/api/photo/${found.photo}/sharpened`;
  else $("shot-restored").removeAttribute("src");
  drawHistogram($("shot-histogram"), found.histogram, found.clipped);
  $("shot-verdict").textContent = sentence(`the photo ${found.verdict}`);
  $("shot-warnings").replaceChildren(...found.warnings.map((text) => holding("li", sentence(text))));
  $("shot-save").href = `/api/photo/${found.photo}/shot.zip`;
}
