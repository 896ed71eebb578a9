"use strict";
for (const box of document.querySelectorAll(".compare")) {
  const pictures = [...box.previousElementSibling.querySelectorAll("img")];
  const titles = [...box.previousElementSibling.querySelectorAll("h3")].map((one) => one.textContent);
  const stage = document.createElement("div");
  stage.className = "stage";
  const range = document.createElement("input");
  Object.assign(range, { type: "range", min: 0, max: 100, step: 1, value: 50 });
  range.setAttribute("aria-label", "Boundary between the left and the right picture, percent of the width");
  const chosen = { left: Number(box.dataset.left), right: Number(box.dataset.right) };
  const show = () => {
    stage.replaceChildren(...["left", "right"].map((side) => pictures[chosen[side]].cloneNode()));
  };
  const move = () => stage.style.setProperty("--at", `${range.value}%`);
  for (const side of ["left", "right"]) {
    const select = document.createElement("select");
    titles.forEach((title, index) => select.add(new Option(title, index, false, index === chosen[side])));
    select.addEventListener("change", () => { chosen[side] = Number(select.value); show(); });
    const label = document.createElement("label");
    label.append(side === "left" ? "Left: " : "Right: ", select);
    box.append(label);
  }
  const drag = (event) => {
    const frame = stage.getBoundingClientRect();
    range.value = (100 * (event.clientX - frame.left)) / frame.width;
    move();
  };
  stage.addEventListener("pointerdown", (event) => { stage.setPointerCapture(event.pointerId); drag(event); });
  stage.addEventListener("pointermove", (event) => { if (event.buttons) drag(event); });
  range.addEventListener("input", move);
  show();
  move();
  const hint = document.createElement("p");
  hint.className = "note";
  hint.textContent = "Any two of the pictures at full size: move the boundary with the pointer or the arrow keys.";
  box.append(stage, range, hint);
  box.hidden = false;
}
