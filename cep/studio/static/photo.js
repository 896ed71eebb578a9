// The card of a photo: the photo, the paths that were estimated in it, and the whole photo sharpened.

import { $, holding, say, sentence } from "./dom.js";
import { drawOnPhoto, drawPath } from "./plots.js";
import { isAlong } from "./state.js";

/** Show how far the work on the photo is, in its place; null when it is over. */
export function busyPhoto(news) {
  $("drop-job").hidden = !news;
  $("drop").classList.toggle("busy", Boolean(news));
  $("sharpen").disabled = Boolean(news);
  if (news) $("drop-share").value = news.share;
}

export function showPhoto(address) {
  const image = $("photo-image");
  if (image.src.endsWith(address)) return;
  image.onerror = hidePhoto;
  image.src = address;
  image.hidden = false;
  $("drop").classList.add("filled");
}

export function hidePhoto() {
  $("photo-image").hidden = true;
  $("drop").classList.remove("filled");
}

let drawnEstimate = []; // estimate, motion and photo as they are drawn
export function drawEstimate(estimate, { motion, photo }, choose) {
  $("drop").classList.toggle("filled", !$("photo-image").hidden);
  const now = [estimate, motion, photo];
  drawSharpened(estimate, photo);
  if (now.every((one, i) => one === drawnEstimate[i])) return;
  drawnEstimate = now;
  $("estimate").hidden = !estimate;
  const hasPhoto = Boolean(photo) && Boolean(estimate?.width);
  $("photo-path").toggleAttribute("hidden", !(hasPhoto && motion.kind === "path"));
  if (!estimate) return;
  $("confidence").value = estimate.confidence ?? 1;
  $("confidence-text").textContent = estimate.confidence === undefined ? "of a file" : `${Math.round(100 * estimate.confidence)} %`;
  $("confidence").hidden = estimate.confidence === undefined;
  $("estimate-warnings").replaceChildren(...(estimate.warnings ?? []).map((text) => holding("li", text)));
  $("alternatives").replaceChildren(...estimate.paths.map((path, i) => {
    const made = document.createElement("button");
    made.type = "button";
    made.setAttribute("role", "radio");
    made.setAttribute("aria-checked", isAlong(motion, path));
    made.setAttribute("aria-label", `Path ${i + 1}: ${path.length_px.toFixed(1)} px, weight ${Math.round(100 * path.weight)} percent`);
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    made.append(svg, holding("span", `${Math.round(100 * path.weight)} %`));
    drawPath(svg, path, "", { dots: false });
    made.addEventListener("click", () => choose(path));
    return made;
  }));
  if (hasPhoto && motion.kind === "path") drawOnPhoto($("photo-path"), motion, estimate.width, estimate.height);
}

/** Offer the whole photo, sharpened: what the estimate would do with it, and what was done. */
export function drawSharpened(estimate, photo) {
  $("sharpened").hidden = !(photo && estimate?.summary);
  if ($("sharpened").hidden) return;
  const { kept, summary, ready } = estimate.sharp ?? { kept: estimate.kept, summary: estimate.summary };
  say("sharpened-line", sentence(summary));
  say("sharpen", ready ? "Save it again" : kept ? "Sharpen and save it anyway" : "Save the sharpened photo");
  $("sharpened-view").hidden = !ready;
  say("sharpened-view", $("photo-image").src.endsWith("/sharpened") ? "Show the photo as taken" : "Show it sharpened");
}

export function saveSharpened(photo) {
  const link = document.createElement("a");
  link.href = `/api/photo/${photo}/sharpened.png`;
  link.download = "sharpened.png";
  link.click();
}
